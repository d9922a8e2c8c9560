//! Projects a plan's path into the camera's picture.

use crate::drop_reason::DropReason;
use nalgebra::Point3;
use wm_camera::camera_info::{check, scale};
use wm_msgs::{
    geometry_msgs::Point,
    sensor_msgs::CameraInfo,
    tf2_msgs::TFMessage,
    visualization_msgs::{Marker, MarkerArray},
};
use wm_wire::frames::{Frames, pose};

/// The planner's markers (docs/viewers.md).
const PLAN: &str = "plan";
/// The most points of a path: one more than the actions of a plan.
const MAX_POINTS: usize = 65;
/// Closer points, and points behind the camera, are not visible \[m\].
const NEAREST_M: f64 = 0.01;

/// The camera's calibration and position.
#[derive(Debug, Default)]
pub(crate) struct Scene {
    frames: Frames,
    camera: Option<(CameraInfo, Pinhole)>,
    /// Columns and rows of the camera's newest picture.
    size: Option<(u32, u32)>,
}

/// A camera in fractions of its picture's width and height; ignores distortion.
#[derive(Clone, Debug, PartialEq)]
struct Pinhole {
    frame: String,
    focal: [f64; 2],
    skew: f64,
    middle: [f64; 2],
}

impl Pinhole {
    fn of(info: &CameraInfo) -> Option<Self> {
        let unit = scale(info, (1, 1)).ok()?;
        let [fx, skew, cx, _, fy, cy, ..] = unit.k;
        Some(Self {
            frame: unit.header.frame_id,
            focal: [fx, fy],
            skew,
            // in ROS, 0 is the centre of the first pixel; here its edge
            middle: [cx + 0.5, cy + 0.5],
        })
    }

    /// Projects a point of the optical frame (REP 103: x right, y down, z ahead).
    fn project(&self, point: &Point3<f64>) -> Option<[f32; 2]> {
        if point.z < NEAREST_M {
            return None;
        }
        let (x, y) = (point.x / point.z, point.y / point.z);
        let [fx, fy] = self.focal;
        let u = (fx * x + self.skew * y + self.middle[0]) as f32;
        let v = (fy * y + self.middle[1]) as f32;
        (u.is_finite() && v.is_finite()).then_some([u, v])
    }
}

/// The end effector's positions before the first action of a plan and after each action, in fractions of the picture's
/// width and height.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PlannedPath {
    /// When the first action begins \[ns\].
    pub begin_ns: i64,
    /// From left and top.
    pub points: Vec<[f32; 2]>,
}

impl Scene {
    /// Takes the calibration; uncalibrated cameras project nothing.
    pub(crate) fn camera(&mut self, info: &CameraInfo) {
        self.camera = Pinhole::of(info).map(|pinhole| (info.clone(), pinhole));
    }

    /// Takes the size of the camera's pictures, which must match the calibration.
    pub(crate) fn picture(&mut self, size: (u32, u32)) {
        self.size = Some(size);
    }

    fn pinhole(&self) -> Option<&Pinhole> {
        let (info, pinhole) = self.camera.as_ref()?;
        let fits = self.size.is_none_or(|size| check(info, size).is_ok());
        fits.then_some(pinhole)
    }

    /// Takes transforms between frames.
    ///
    /// # Errors
    /// Some of them are left out; the others count.
    pub(crate) fn transforms(
        &mut self,
        message: &TFMessage,
        is_static: bool,
    ) -> Result<(), DropReason> {
        let mut taken = Ok(());
        for one in &message.transforms {
            let names = (&*one.header.frame_id, &*one.child_frame_id);
            let transform = pose::of_transform(&one.transform).ok();
            let stamp_ns = one.header.stamp.checked_nanos().ok();
            let is_taken = stamp_ns
                .zip(transform)
                .is_some_and(|(stamp_ns, transform)| {
                    let taken = self.frames.take(names, is_static, stamp_ns, transform);
                    taken.is_ok()
                });
            if !is_taken {
                taken = Err(DropReason::BadTransform);
            }
        }
        taken
    }

    /// The path of the plan among these markers. `None` without a plan, without the camera's position, or if a part of
    /// the path is behind the camera.
    pub(crate) fn way(&self, markers: &MarkerArray) -> Option<PlannedPath> {
        let is_way = |marker: &&Marker| {
            marker.ns == PLAN && marker.r#type == Marker::LINE_STRIP && marker.action == Marker::ADD
        };
        let marker = markers.markers.iter().find(is_way)?;
        let camera = self.pinhole()?;
        let (_, to_camera) = self
            .frames
            .find(&camera.frame, &marker.header.frame_id)
            .ok()?;
        let to_camera = to_camera * pose::of_pose(&marker.pose).ok()?;
        let see = |at: &Point| camera.project(&(to_camera * Point3::new(at.x, at.y, at.z)));
        let points = marker.points.iter().take(MAX_POINTS).map(see);
        Some(PlannedPath {
            begin_ns: marker.header.stamp.to_nanos(),
            points: points.collect::<Option<_>>()?,
        })
    }
}

#[cfg(test)]
mod tests {
    use wm_msgs::{
        builtin_interfaces::Time,
        geometry_msgs::{Pose, Quaternion},
        std_msgs::Header,
    };
    use wm_sim::{message, render::Camera, render::IMAGE_SIZE};

    use super::*;

    fn header(frame: &str) -> Header {
        Header {
            stamp: Time::from_nanos(7),
            frame_id: frame.to_owned(),
        }
    }

    fn way(points: &[[f64; 3]]) -> MarkerArray {
        let point = |[x, y, z]: [f64; 3]| Point { x, y, z };
        let way = Marker {
            header: header("base_link"),
            ns: PLAN.to_owned(),
            r#type: Marker::LINE_STRIP,
            pose: Pose {
                orientation: Quaternion {
                    w: 1.0,
                    ..Quaternion::default()
                },
                ..Pose::default()
            },
            points: points.iter().copied().map(point).collect(),
            ..Marker::default()
        };
        let box_of_workspace = Marker {
            ns: "workspace".to_owned(),
            ..way.clone()
        };
        MarkerArray {
            markers: vec![box_of_workspace, way],
        }
    }

    fn scene(camera: &Camera) -> Scene {
        let mut scene = Scene::default();
        scene.camera(&message::camera_info(camera, header("camera")));
        let place = message::transform(&camera.base_from_optical(), header("base_link"), "camera");
        let message = TFMessage {
            transforms: vec![place],
        };
        assert_eq!(scene.transforms(&message, true), Ok(()));
        scene
    }

    #[test]
    fn projected_path_matches_the_simulator() {
        let camera = Camera::beside_the_arm();
        let points = [[0.262, 0.0, 0.095], [0.3, 0.05, 0.02], [0.2, -0.1, 0.15]];
        let found = scene(&camera).way(&way(&points)).unwrap();
        assert_eq!((found.begin_ns, found.points.len()), (7, 3));
        for (point, seen) in points.into_iter().zip(found.points) {
            // edges of pixels, from 0 to the size
            let pixel = camera.pixel(&point.into()).unwrap();
            for (exact, fraction) in pixel.into_iter().zip(seen) {
                assert!((exact - fraction * IMAGE_SIZE as f32).abs() < 0.01);
            }
        }
    }

    #[test]
    fn unknown_cameras_and_hidden_points_give_no_path() {
        let camera = Camera::beside_the_arm();
        let good = way(&[[0.26, 0.0, 0.1]]);
        assert_eq!(Scene::default().way(&good), None);
        let mut scene = scene(&camera);
        assert!(scene.way(&good).is_some());
        let mut nowhere = message::transform(&camera.base_from_optical(), header("a"), "b");
        nowhere.transform.rotation.w = f64::NAN;
        let message = TFMessage {
            transforms: vec![nowhere],
        };
        assert_eq!(
            scene.transforms(&message, false),
            Err(DropReason::BadTransform)
        );
        let eye = camera.base_from_optical().translation.vector;
        assert_eq!(scene.way(&way(&[[eye.x, eye.y, eye.z]])), None);
        assert_eq!(scene.way(&MarkerArray::default()), None);
        let mut elsewhere = good.clone();
        elsewhere.markers[1].header.frame_id = "another_robot".to_owned();
        assert_eq!(scene.way(&elsewhere), None);
        let size = IMAGE_SIZE;
        scene.picture((size, size));
        assert!(scene.way(&good).is_some());
        scene.picture((640, 480));
        assert_eq!(scene.way(&good), None, "camera_info is of other pictures");
        scene.picture((size, size));
        scene.camera(&CameraInfo::default());
        assert_eq!(scene.way(&good), None);
    }
}
