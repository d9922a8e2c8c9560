//! Messages of cameras and frames, for bags and live topics.

use nalgebra::Isometry3;
use wm_msgs::{
    geometry_msgs::{Point, Pose, Quaternion, Transform, TransformStamped, Vector3},
    sensor_msgs::CameraInfo,
    std_msgs::Header,
};

use crate::render::{Camera, IMAGE_SIZE};

/// A pinhole camera without distortion.
pub fn camera_info(camera: &Camera, header: Header) -> CameraInfo {
    let focal = camera.focal_px();
    // In ROS, 0 is the middle of the first pixel; in the simulator, its edge.
    let middle = f64::from(IMAGE_SIZE) / 2.0 - 0.5;
    CameraInfo {
        header,
        height: IMAGE_SIZE,
        width: IMAGE_SIZE,
        distortion_model: "plumb_bob".into(),
        d: vec![0.0; 5],
        k: [focal, 0.0, middle, 0.0, focal, middle, 0.0, 0.0, 1.0],
        r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: [
            focal, 0.0, middle, 0.0, 0.0, focal, middle, 0.0, 0.0, 0.0, 1.0, 0.0,
        ],
        ..CameraInfo::default()
    }
}

/// The pose of a frame.
pub fn pose(frame: &Isometry3<f64>) -> Pose {
    let (at, turn) = (frame.translation.vector, frame.rotation);
    Pose {
        position: Point {
            x: at.x,
            y: at.y,
            z: at.z,
        },
        orientation: Quaternion {
            x: turn.i,
            y: turn.j,
            z: turn.k,
            w: turn.w,
        },
    }
}

/// The frame `child` in the header's frame.
pub fn transform(frame: &Isometry3<f64>, header: Header, child: &str) -> TransformStamped {
    let Pose {
        position: Point { x, y, z },
        orientation,
    } = pose(frame);
    TransformStamped {
        header,
        child_frame_id: child.to_owned(),
        transform: Transform {
            translation: Vector3 { x, y, z },
            rotation: orientation,
        },
    }
}
