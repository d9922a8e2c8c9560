//! Targets for data of peers: CDR of every message type, parts of large messages, and pictures.

use serde::{Serialize, de::DeserializeOwned};
use wm_msgs::{
    builtin_interfaces, cdr, diagnostic_msgs, geometry_msgs, lifecycle_msgs, rosbag2_interfaces,
    rosgraph_msgs, sensor_msgs, std_msgs, std_srvs, tf2_msgs, wm_msgs as wm,
};

/// Decodes an input as each type.
macro_rules! round_trip_each {
    ($data:expr, [$($type:ty),* $(,)?]) => { $(round_trip::<$type>($data);)* };
}

/// Decodes the bytes as each message and request type that a node receives.
///
/// # Panics
/// A decoded value does not survive encoding.
pub fn message(data: &[u8]) {
    round_trip_each!(
        data,
        [
            builtin_interfaces::Time,
            builtin_interfaces::Duration,
            diagnostic_msgs::DiagnosticArray,
            geometry_msgs::PoseStamped,
            geometry_msgs::TwistStamped,
            lifecycle_msgs::TransitionEvent,
            lifecycle_msgs::ChangeStateRequest,
            rosbag2_interfaces::BurstRequest,
            rosbag2_interfaces::PlayRequest,
            rosbag2_interfaces::RecordRequest,
            rosbag2_interfaces::SeekRequest,
            rosgraph_msgs::Clock,
            sensor_msgs::CompressedImage,
            sensor_msgs::Image,
            sensor_msgs::JointState,
            std_msgs::Bool,
            std_msgs::Float32,
            std_msgs::Header,
            std_msgs::String,
            std_srvs::SetBoolRequest,
            std_srvs::TriggerRequest,
            tf2_msgs::TFMessage,
            wm::Action,
            wm::ActionCandidates,
            wm::ActionChunk,
            wm::Assessment,
            wm::EnvObservation,
            wm::EnvResetRequest,
            wm::EnvStepRequest,
            wm::CameraState,
            wm::ExecutorStatus,
            wm::Latent,
            wm::Plan,
            wm::Prediction,
            wm::PredictionError,
            wm::ResetRequest,
            wm::Timing,
        ]
    );
}

/// Decodes and encodes twice; compares encodings, since NaN differs from itself.
fn round_trip<T: Serialize + DeserializeOwned>(data: &[u8]) {
    let Ok(value) = cdr::from_bytes::<T>(data) else {
        return;
    };
    let once = cdr::to_bytes(&value);
    let twice = once
        .as_ref()
        .ok()
        .and_then(|bytes| cdr::from_bytes::<T>(bytes).ok())
        .and_then(|value| cdr::to_bytes(&value).ok());
    assert_eq!(
        once.ok(),
        twice,
        "{} does not survive encoding",
        std::any::type_name::<T>()
    );
}

/// Decodes a sample of the topic for parts of large messages.
pub fn part(data: &[u8]) {
    wm_ros::fuzzing::part(data);
}

/// Decodes the requests of the parameter and logger services.
pub fn request(data: &[u8]) {
    wm_ros::fuzzing::request(data);
}

/// Decodes the pixels of an image message, raw and compressed.
pub fn picture(data: &[u8]) {
    if let Ok(image) = cdr::from_bytes::<sensor_msgs::Image>(data) {
        wm_camera::image_message::decode_image(&image).ok();
    }
    if let Ok(image) = cdr::from_bytes::<sensor_msgs::CompressedImage>(data) {
        let checked = wm_camera::image_message::check_compressed(&image);
        let decoded = wm_camera::image_message::decode_compressed(&image);
        assert!(
            checked.is_ok() || decoded.is_err(),
            "a rejected picture is decoded: {checked:?}"
        );
    }
    // A JPEG without a message, since most mutations of a message break its length.
    wm_camera::jpeg::decode(data).ok();
}
