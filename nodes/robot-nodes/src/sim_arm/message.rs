//! The messages that the arm publishes.

use std::time::Duration;

use anyhow::Result;
use image::RgbImage;
use wm_camera::image_message::encode_image;
use wm_msgs::{
    builtin_interfaces::Time,
    geometry_msgs::{PoseArray, PoseStamped},
    sensor_msgs::{CameraInfo, JointState},
    std_msgs::Header,
    tf2_msgs::TFMessage,
    vision_msgs::{LabelInfo, VisionClass},
    visualization_msgs::MarkerArray,
    wm_msgs::{Action, Goal},
};
use wm_sim::{
    JOINT_NAMES, Target, World,
    message::{pose as pose_message, transform},
    render::Camera,
};
use wm_wire::{
    marker::{Style, ball},
    transport::{Pictures, Transports},
};

use super::{SimArmStep, StepMotion, Tick, View};

/// Translucent green, so that an object in it is visible. It outlives four lost messages.
const GOAL: Style = Style {
    ns: "goal",
    color: [0.2, 0.8, 0.3, 0.4],
    lifetime: Duration::from_secs(1),
};
/// The same as in the simulator's bags.
const JPEG_QUALITY: u8 = 95;

fn header(stamp_ns: i64, frame_id: &str) -> Header {
    Header {
        stamp: Time::from_nanos(stamp_ns),
        frame_id: frame_id.to_owned(),
    }
}

pub(super) fn pictures(
    picture: &RgbImage,
    view: View,
    stamp_ns: i64,
    transports: Transports,
) -> Result<Pictures> {
    let header = header(stamp_ns, view.frame_id());
    Ok(Pictures::encode(picture, header, transports, JPEG_QUALITY)?)
}

pub(super) fn goal(pictures: &[RgbImage], stamp_ns: i64) -> Goal {
    let header = || header(stamp_ns, View::Side.frame_id());
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
        pose: pose_message(&tick.tool.frame()),
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

pub(super) fn action(done: &StepMotion, base_frame: &str) -> Action {
    Action {
        header: header(done.stamp_ns, base_frame),
        values: done.action.values().to_vec(),
    }
}

/// A pinhole camera without distortion.
pub(super) fn camera_info(camera: &Camera, view: View, stamp_ns: i64) -> CameraInfo {
    wm_sim::message::camera_info(camera, header(stamp_ns, view.frame_id()))
}

/// The frames of the tool and of the arm's links.
pub(super) fn transforms(tick: &Tick, base_frame: &str, tool_frame: &str) -> TFMessage {
    let header = |frame_id: &str| header(tick.stamp_ns, frame_id);
    let tool = transform(&tick.tool.frame(), header(base_frame), tool_frame);
    let links = tick
        .joints
        .map(|positions| wm_sim::link_frames(base_frame, &positions));
    let links = links.into_iter().flatten();
    let links = links.map(|link| transform(&link.frame, header(&link.parent), link.link));
    TFMessage {
        transforms: std::iter::once(tool).chain(links).collect(),
    }
}

/// The target of the tool or of an object: a ball whose radius is the tolerance.
pub(super) fn target(target: &Target, stamp_ns: i64, base_frame: &str) -> MarkerArray {
    let place = match target {
        Target::Tool { position } => *position,
        Target::Object { place, .. } => *place,
    };
    let header = header(stamp_ns, base_frame);
    MarkerArray {
        markers: vec![ball(header, &GOAL, place.into(), target.tolerance_m())],
    }
}

/// The optical frames of the cameras.
pub(super) fn camera_transforms(step: &SimArmStep, stamp_ns: i64, base_frame: &str) -> TFMessage {
    let of = |(view, camera): (View, &Camera)| {
        let frame = camera.base_from_optical();
        transform(&frame, header(stamp_ns, base_frame), view.frame_id())
    };
    TFMessage {
        transforms: step.eyes().map(of).collect(),
    }
}

/// The poses of the objects, in the order of [`object_names`].
pub(super) fn objects(world: &World, stamp_ns: i64, base_frame: &str) -> PoseArray {
    let objects = world.objects().iter();
    PoseArray {
        header: header(stamp_ns, base_frame),
        poses: objects.map(|object| pose_message(&object.pose)).collect(),
    }
}

/// The names of the objects by their index in [`objects`].
pub(super) fn object_names(world: &World, stamp_ns: i64, base_frame: &str) -> LabelInfo {
    let objects = (0..).zip(world.objects());
    LabelInfo {
        header: header(stamp_ns, base_frame),
        class_map: objects
            .map(|(class_id, object)| VisionClass {
                class_id,
                class_name: object.name(),
            })
            .collect(),
        threshold: 0.0,
    }
}
