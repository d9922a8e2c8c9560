//! The `camera_info` of the predicted pictures.

use wm_camera::{
    camera_frame::CameraFrame,
    camera_info::{CameraInfoError, check, picture_size, scale_part},
};
use wm_model::{Fit, PictureSize};
use wm_msgs::{sensor_msgs::CameraInfo, std_msgs::Header};
use wm_ros::{Node, Qos};
use wm_wire::transport::{ImageSubscription, Pictures, Transports};

/// The newest camera_info, and the size of the pictures that it has to fit.
#[derive(Default)]
pub(super) struct CameraView {
    info: Option<CameraInfo>,
    /// Until a frame has shown the size.
    images: Option<ImageSubscription>,
    size: Option<(u32, u32)>,
    reported: Option<CameraInfoError>,
}

impl CameraView {
    /// Takes a camera_info. The first one, and one of another layout, has to be compared with a frame.
    ///
    /// # Errors
    /// The graph refuses the subscription.
    pub fn take_info(&mut self, node: &Node, info: CameraInfo) -> Result<(), wm_ros::Error> {
        let layout = |info: &CameraInfo| {
            let binning = (info.binning_x, info.binning_y);
            (info.width, info.height, binning, info.roi)
        };
        if self.info.as_ref().map(layout) != Some(layout(&info)) {
            self.size = None;
            // Two cameras on one topic may alternate: one subscription serves until a frame arrives.
            if self.images.is_none() {
                let (topic, qos) = ("/camera/image_raw", Qos::best_effort(1));
                let images = ImageSubscription::new(node, topic, Transports::BOTH, qos);
                self.images = Some(images?);
            }
        }
        self.info = Some(info);
        Ok(())
    }

    /// The next frame, until the size is known; pending from then on. Cancel safe.
    pub async fn frame(&mut self) -> Option<CameraFrame> {
        match &mut self.images {
            Some(images) => images.recv().await.map(|received| received.message),
            None => std::future::pending().await,
        }
    }

    /// Takes the size of the camera's pictures.
    pub fn take_frame(&mut self, frame: &CameraFrame) {
        self.size = frame.size();
        if self.size.is_some() {
            self.images = None;
        }
    }

    /// The `camera_info` of predicted pictures of this size and fit. `None` if they are another camera's, if no picture of the
    /// camera has arrived yet, or if its `camera_info` does not fit that picture, which is logged once.
    pub fn of(&mut self, pictures: &Pictures, size: (u32, u32), fit: Fit) -> Option<CameraInfo> {
        let found = info_of(self.info.as_ref()?, self.size?, pictures, (size, fit));
        match found {
            Ok(info) => {
                self.reported = None;
                info
            }
            Err(error) => {
                // A camera that is not calibrated is common, and no fault.
                if self.reported != Some(error) && error != CameraInfoError::NotCalibrated {
                    tracing::warn!("predicted/camera_info is not published: {error}");
                }
                self.reported = Some(error);
                None
            }
        }
    }
}

fn info_of(
    camera: &CameraInfo,
    camera_size: (u32, u32),
    pictures: &Pictures,
    ((width, height), fit): ((u32, u32), Fit),
) -> Result<Option<CameraInfo>, CameraInfoError> {
    let Some(header) = header(pictures) else {
        return Ok(None);
    };
    if header.frame_id != camera.header.frame_id {
        return Ok(None);
    }
    check(camera, camera_size)?;
    let (columns, rows) = picture_size(camera)?;
    let from = PictureSize {
        width: columns,
        height: rows,
    };
    let to = PictureSize { width, height };
    let Some(placement) = fit.placement(from, to) else {
        return Ok(None);
    };
    let [left, top, of_width, of_height] = placement.view(to);
    let (columns, rows) = (f64::from(columns), f64::from(rows));
    let shown = [
        left / columns,
        top / rows,
        of_width / columns,
        of_height / rows,
    ];
    let info = scale_part(camera, shown, (width, height))?;
    Ok(Some(CameraInfo {
        header: header.clone(),
        ..info
    }))
}

fn header(pictures: &Pictures) -> Option<&Header> {
    match pictures {
        Pictures { raw: Some(raw), .. } => Some(&raw.header),
        Pictures { compressed, .. } => compressed.as_ref().map(|compressed| &compressed.header),
    }
}

#[cfg(test)]
mod tests {
    use wm_msgs::sensor_msgs::Image;

    use super::*;

    fn header(frame_id: &str, sec: i32) -> Header {
        let mut header = Header {
            frame_id: frame_id.to_owned(),
            ..Header::default()
        };
        header.stamp.sec = sec;
        header
    }

    fn camera() -> CameraInfo {
        CameraInfo {
            header: header("camera", 1),
            width: 256,
            height: 256,
            k: [455.0, 0.0, 127.5, 0.0, 455.0, 127.5, 0.0, 0.0, 1.0],
            ..CameraInfo::default()
        }
    }

    fn pictures(frame_id: &str) -> Pictures {
        Pictures {
            raw: Some(Image {
                header: header(frame_id, 3),
                ..Image::default()
            }),
            compressed: None,
        }
    }

    #[test]
    fn camera_info_is_of_its_own_pictures_alone() {
        let square = ((128, 128), Fit::Stretch);
        let of = |pictures: &Pictures| info_of(&camera(), (256, 256), pictures, square);
        let info = of(&pictures("camera")).unwrap().unwrap();
        assert_eq!(info.header, header("camera", 3), "that of the picture");
        assert_eq!((info.width, info.k[0], info.k[2]), (128, 227.5, 63.5));
        assert_eq!(of(&pictures("other")), Ok(None));
        assert_eq!(of(&Pictures::default()), Ok(None));
    }

    #[test]
    fn camera_info_follows_the_fit() {
        // The model sees the middle 720 columns of 1280, or all of them between bars.
        let wide = CameraInfo {
            width: 1280,
            height: 720,
            k: [900.0, 0.0, 679.5, 0.0, 900.0, 359.5, 0.0, 0.0, 1.0],
            ..camera()
        };
        let principal = |fit| {
            let seen = info_of(&wide, (1280, 720), &pictures("camera"), ((360, 360), fit));
            let info = seen.unwrap().unwrap();
            [0, 2, 4, 5].map(|at| info.k[at])
        };
        assert_eq!(principal(Fit::Crop), [450.0, 199.5, 450.0, 179.5]);
        // 202.5 rows round to 203, between bars of 78 and 79 rows.
        let padded = [253.125, 190.75, 253.75, 179.0];
        for (found, expected) in principal(Fit::Pad).into_iter().zip(padded) {
            assert!((found - expected).abs() < 1e-9, "{found} {expected}");
        }
    }

    #[test]
    fn camera_info_that_does_not_fit_its_picture_is_not_published() {
        let mut view = CameraView {
            info: Some(camera()),
            ..CameraView::default()
        };
        let mut of = |size: Option<(u32, u32)>, info: Option<CameraInfo>| {
            view.size = size;
            view.info = info;
            view.of(&pictures("camera"), (128, 128), Fit::Stretch)
                .is_some()
        };
        assert!(!of(None, Some(camera())), "the size is not known yet");
        assert!(!of(Some((640, 480)), Some(camera())));
        let mut broken = camera();
        broken.k[0] = f64::NAN;
        assert!(!of(Some((256, 256)), Some(broken)));
        assert!(!of(Some((256, 256)), Some(CameraInfo::default())));
        assert!(of(Some((256, 256)), Some(camera())));
    }
}
