//! What the arm tells, as messages.

use anyhow::Result;
use image::RgbImage;
use wm_camera::image_message::{encode_image, encode_jpeg};
use wm_msgs::{
    builtin_interfaces::Time,
    geometry_msgs::PoseStamped,
    sensor_msgs::JointState,
    std_msgs::Header,
    wm_msgs::{Action, Goal},
};
use wm_sim::{CAMERA_FRAME, JOINT_NAMES, pose_message};
use wm_wire::transport::{Pictures, Transports};

use super::{Done, Tick};

/// As in the simulator's bags.
const JPEG_QUALITY: u8 = 95;

fn header(stamp_ns: i64, frame_id: &str) -> Header {
    Header {
        stamp: Time::from_nanos(stamp_ns),
        frame_id: frame_id.to_owned(),
    }
}

pub(super) fn pictures(
    picture: &RgbImage,
    stamp_ns: i64,
    transports: Transports,
) -> Result<Pictures> {
    let header = || header(stamp_ns, CAMERA_FRAME);
    let raw = transports.raw.then(|| encode_image(picture, header()));
    let compressed = transports
        .compressed
        .then(|| encode_jpeg(picture, header(), JPEG_QUALITY));
    Ok(Pictures {
        raw,
        compressed: compressed.transpose()?,
    })
}

pub(super) fn goal(pictures: &[RgbImage], stamp_ns: i64) -> Goal {
    let header = || header(stamp_ns, CAMERA_FRAME);
    let images = pictures
        .iter()
        .map(|picture| encode_image(picture, header()));
    Goal {
        header: header(),
        images: images.collect(),
        ..Goal::default()
    }
}

pub(super) fn pose(tick: &Tick, base_frame: &str) -> PoseStamped {
    PoseStamped {
        header: header(tick.stamp_ns, base_frame),
        pose: pose_message(&tick.tool),
    }
}

pub(super) fn joints(positions: [f64; 8], stamp_ns: i64) -> JointState {
    JointState {
        header: header(stamp_ns, ""),
        name: JOINT_NAMES.map(str::to_owned).to_vec(),
        position: positions.to_vec(),
        velocity: Vec::new(),
        effort: Vec::new(),
    }
}

pub(super) fn action(done: &Done, base_frame: &str) -> Action {
    Action {
        header: header(done.stamp_ns, base_frame),
        values: done.action.values().to_vec(),
    }
}
