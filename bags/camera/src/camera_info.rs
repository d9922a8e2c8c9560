//! Camera calibration for scaled pictures and parts of pictures.

use thiserror::Error;
use wm_msgs::sensor_msgs::{CameraInfo, RegionOfInterest};

/// The camera_info topic of an image topic, as in image_transport.
pub fn info_topic(images: &str) -> String {
    match images.rsplit_once('/') {
        Some((folder, _)) => format!("{folder}/camera_info"),
        None => "camera_info".to_owned(),
    }
}

/// A fault of a camera_info message.
#[expect(missing_docs, reason = "the error texts describe variants and fields")]
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum CameraInfoError {
    /// Focal lengths of 0 (REP 104: not calibrated), or a picture without pixels.
    #[error("the camera is not calibrated: its focal lengths are 0")]
    NotCalibrated,
    #[error("camera_info has values that are not finite")]
    NotFinite,
    #[error("camera_info has a region of interest beyond its {width}x{height} pixels")]
    Region { width: u32, height: u32 },
    #[error(
        "camera_info describes pictures of {}x{} pixels, after binning and region of interest; the camera's have {}x{}",
        .expected.0, .expected.1, .found.0, .found.1
    )]
    Size {
        /// Columns and rows in camera_info.
        expected: (u32, u32),
        /// Columns and rows of the picture.
        found: (u32, u32),
    },
}

/// Checks that `info` fits pictures of this size.
pub fn check(info: &CameraInfo, picture: (u32, u32)) -> Result<(), CameraInfoError> {
    let expected = picture_size(info)?;
    // Drivers round odd sizes up or down.
    let fits = |a: u32, b: u32| a.abs_diff(b) <= 1;
    match fits(expected.0, picture.0) && fits(expected.1, picture.1) {
        true => Ok(()),
        false => Err(CameraInfoError::Size {
            expected,
            found: picture,
        }),
    }
}

/// Size of the region of the sensor that pictures show \[px before binning\].
fn sensor_region(info: &CameraInfo) -> Result<(u32, u32), CameraInfoError> {
    let values = info.k.iter().chain(&info.p).chain(&info.r).chain(&info.d);
    if values.into_iter().any(|value| !value.is_finite()) {
        return Err(CameraInfoError::NotFinite);
    }
    let roi = info.roi;
    let fits =
        |offset: u32, side: u32, all: u32| offset.checked_add(side).is_some_and(|end| end <= all);
    // All zero: the whole sensor.
    let size = match (roi.width, roi.height) {
        (0, 0) => (info.width, info.height),
        size if fits(roi.x_offset, size.0, info.width)
            && fits(roi.y_offset, size.1, info.height) =>
        {
            size
        }
        _ => {
            return Err(CameraInfoError::Region {
                width: info.width,
                height: info.height,
            });
        }
    };
    let [fx, _, _, _, fy, ..] = info.k;
    match size.0 == 0 || size.1 == 0 || fx == 0.0 || fy == 0.0 {
        true => Err(CameraInfoError::NotCalibrated),
        false => Ok(size),
    }
}

/// The calibration for the camera's whole picture, scaled to `width` x `height` pixels, with the header of `info`.
///
/// As in ROS, pixel centres have whole coordinates, so the principal point scales with the pixel edges. Binning and region
/// of interest are included in the result, which has neither. Distortion applies to directions and stays.
/// and stays.
///
/// # Errors
/// [`CameraInfoError`]: not calibrated, not finite, or a region beyond the sensor.
pub fn scale(info: &CameraInfo, size: (u32, u32)) -> Result<CameraInfo, CameraInfoError> {
    scale_part(info, [0.0, 0.0, 1.0, 1.0], size)
}

/// Columns and rows of the picture of `info`: its region of interest, after binning.
///
/// # Errors
/// [`CameraInfoError`]: not calibrated, not finite, or a region beyond the sensor.
pub fn picture_size(info: &CameraInfo) -> Result<(u32, u32), CameraInfoError> {
    let (width, height) = sensor_region(info)?;
    Ok((
        width / info.binning_x.max(1),
        height / info.binning_y.max(1),
    ))
}

/// As [`scale`], for a part of the camera's picture: left, top, width and height as fractions of the picture. The part may
/// exceed the picture, as in a picture with bars.
///
/// # Errors
/// [`CameraInfoError`]: not calibrated, not finite, or a region beyond the sensor.
pub fn scale_part(
    info: &CameraInfo,
    [from_left, from_top, part_width, part_height]: [f64; 4],
    (width, height): (u32, u32),
) -> Result<CameraInfo, CameraInfoError> {
    let roi = info.roi;
    let (seen_width, seen_height) = sensor_region(info)?;
    let [fx, skew, cx, _, fy, cy, ..] = info.k;
    if width == 0 || height == 0 {
        return Err(CameraInfoError::NotCalibrated);
    }
    let (seen_width, seen_height) = (f64::from(seen_width), f64::from(seen_height));
    let (x, y) = (
        f64::from(width) / (seen_width * part_width),
        f64::from(height) / (seen_height * part_height),
    );
    let (left, top) = (
        f64::from(roi.x_offset) + from_left * seen_width,
        f64::from(roi.y_offset) + from_top * seen_height,
    );
    let column = |at: f64| (at - left + 0.5) * x - 0.5;
    let row = |at: f64| (at - top + 0.5) * y - 0.5;
    let [pfx, pskew, pcx, tx, _, pfy, pcy, ty, ..] = info.p;
    // Some drivers do not fill the projection.
    let p = match pfx == 0.0 {
        true => info.p,
        false => [
            pfx * x,
            pskew * x,
            column(pcx),
            tx * x,
            0.0,
            pfy * y,
            row(pcy),
            ty * y,
            0.0,
            0.0,
            1.0,
            0.0,
        ],
    };
    Ok(CameraInfo {
        width,
        height,
        k: [
            fx * x,
            skew * x,
            column(cx),
            0.0,
            fy * y,
            row(cy),
            0.0,
            0.0,
            1.0,
        ],
        p,
        binning_x: 0,
        binning_y: 0,
        roi: RegionOfInterest::default(),
        ..info.clone()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> CameraInfo {
        CameraInfo {
            width: 640,
            height: 480,
            k: [500.0, 0.0, 319.5, 0.0, 510.0, 239.5, 0.0, 0.0, 1.0],
            p: [
                500.0, 0.0, 319.5, -50.0, 0.0, 510.0, 239.5, 0.0, 0.0, 0.0, 1.0, 0.0,
            ],
            d: vec![0.1, 0.0, 0.0, 0.0, 0.0],
            ..CameraInfo::default()
        }
    }

    /// Projects a direction (x / z, y / z) to the picture \[px\].
    fn place(info: &CameraInfo, x: f64, y: f64) -> (f64, f64) {
        (info.k[0] * x + info.k[2], info.k[4] * y + info.k[5])
    }

    #[test]
    fn camera_info_topic_is_next_to_the_image_topic() {
        for (images, expected) in [
            ("/front/image_raw", "/front/camera_info"),
            ("/image", "/camera_info"),
            ("image", "camera_info"),
        ] {
            assert_eq!(info_topic(images), expected);
        }
    }

    #[test]
    fn scaling_keeps_the_edges_of_the_picture() {
        let (before, after) = (camera(), scale(&camera(), (256, 128)).unwrap());
        assert_eq!((after.width, after.height), (256, 128));
        // The directions of the upper left and lower right corner, at the outer edges of the corner pixels.
        for (at, expected) in [
            ((-0.5, -0.5), (-0.5, -0.5)),
            ((639.5, 479.5), (255.5, 127.5)),
        ] {
            let x = (at.0 - before.k[2]) / before.k[0];
            let y = (at.1 - before.k[5]) / before.k[4];
            let (column, row) = place(&after, x, y);
            assert!((column - expected.0).abs() < 1e-9 && (row - expected.1).abs() < 1e-9);
        }
        assert_eq!(after.p[0], after.k[0]);
        assert_eq!((after.p[2], after.p[6]), (after.k[2], after.k[5]));
        assert!(
            (after.p[3] + 20.0).abs() < 1e-9,
            "the baseline: {:?}",
            after.p
        );
        assert_eq!(after.d, before.d);
        assert_eq!(scale(&before, (640, 480)), Ok(before));
    }

    #[test]
    fn binning_and_region_of_interest_are_applied() {
        let part = CameraInfo {
            binning_x: 2,
            binning_y: 2,
            roi: RegionOfInterest {
                x_offset: 160,
                y_offset: 120,
                width: 320,
                height: 240,
                do_rectify: false,
            },
            ..camera()
        };
        let after = scale(&part, (160, 120)).unwrap();
        // The centre of the region is the centre of the picture.
        assert_eq!((after.k[2], after.k[5]), (79.5, 59.5));
        assert_eq!((after.k[0], after.k[4]), (250.0, 255.0));
        assert_eq!(
            (after.binning_x, after.roi),
            (0, RegionOfInterest::default())
        );
    }

    #[test]
    fn uncalibrated_camera_is_rejected() {
        let blind = CameraInfo {
            k: [0.0; 9],
            ..camera()
        };
        let none = Err(CameraInfoError::NotCalibrated);
        assert_eq!(scale(&blind, (256, 256)), none);
        assert_eq!(scale(&CameraInfo::default(), (256, 256)), none);
        assert_eq!(scale(&camera(), (0, 256)), none);
    }

    #[test]
    fn camera_info_of_other_size_is_rejected() {
        assert_eq!(check(&camera(), (640, 480)), Ok(()));
        for size in [(1280, 720), (320, 240), (480, 640), (64, 64)] {
            let wrong = check(&camera(), size);
            assert!(
                matches!(wrong, Err(CameraInfoError::Size { .. })),
                "{size:?}: {wrong:?}"
            );
        }
        let region = |x_offset, width| RegionOfInterest {
            x_offset,
            y_offset: 0,
            width,
            height: 240,
            do_rectify: false,
        };
        let binned = CameraInfo {
            binning_x: 2,
            binning_y: 2,
            roi: region(10, 321),
            ..camera()
        };
        assert_eq!(check(&binned, (160, 120)), Ok(()));
        assert!(check(&binned, (320, 240)).is_err());
        for (x_offset, width) in [(400, 320), (u32::MAX, 2)] {
            let beyond = CameraInfo {
                roi: region(x_offset, width),
                ..camera()
            };
            let wrong = scale(&beyond, (64, 64));
            assert!(
                matches!(wrong, Err(CameraInfoError::Region { .. })),
                "{wrong:?}"
            );
        }
    }

    #[test]
    fn values_that_are_not_finite_are_rejected() {
        let mut infos = vec![camera(); 4];
        infos[0].k[2] = f64::NAN;
        infos[1].p[3] = f64::INFINITY;
        infos[2].d[0] = f64::NAN;
        infos[3].r[8] = f64::NEG_INFINITY;
        for info in infos {
            assert_eq!(check(&info, (640, 480)), Err(CameraInfoError::NotFinite));
            assert_eq!(scale(&info, (64, 64)), Err(CameraInfoError::NotFinite));
        }
    }

    #[test]
    fn part_moves_the_principal_point_and_keeps_directions() {
        let before = CameraInfo {
            width: 1280,
            height: 720,
            k: [900.0, 0.0, 639.5, 0.0, 900.0, 359.5, 0.0, 0.0, 1.0],
            p: [
                900.0, 0.0, 639.5, 0.0, 0.0, 900.0, 359.5, 0.0, 0.0, 0.0, 1.0, 0.0,
            ],
            ..CameraInfo::default()
        };
        assert_eq!(picture_size(&before), Ok((1280, 720)));
        // The middle square at half size; and bars of 280 rows above and below, at a fifth.
        let middle = [280.0 / 1280.0, 0.0, 720.0 / 1280.0, 1.0];
        let cut = scale_part(&before, middle, (360, 360)).unwrap();
        let bars = [0.0, -280.0 / 720.0, 1.0, 1280.0 / 720.0];
        let padded = scale_part(&before, bars, (256, 256)).unwrap();
        for (x, y) in [(0.0, 0.0), (-0.2, 0.3), (0.1, -0.1)] {
            // Scales apply to pixel edges.
            let (column, row) = place(&before, x, y);
            let (column, row) = (column + 0.5, row + 0.5);
            let (u, v) = place(&cut, x, y);
            assert!((u + 0.5 - (column - 280.0) / 2.0).abs() < 1e-9, "{u}");
            assert!((v + 0.5 - row / 2.0).abs() < 1e-9, "{v}");
            let (u, v) = place(&padded, x, y);
            assert!((u + 0.5 - column / 5.0).abs() < 1e-9, "{u}");
            assert!((v + 0.5 - (row + 280.0) / 5.0).abs() < 1e-9, "{v}");
        }
        assert_eq!((cut.p[2], cut.p[6]), (cut.k[2], cut.k[5]));
    }

    #[test]
    fn picture_size_is_the_binned_region() {
        let binned = CameraInfo {
            binning_x: 2,
            binning_y: 4,
            roi: RegionOfInterest {
                width: 320,
                height: 240,
                ..RegionOfInterest::default()
            },
            ..camera()
        };
        assert_eq!(picture_size(&binned), Ok((160, 60)));
    }
}
