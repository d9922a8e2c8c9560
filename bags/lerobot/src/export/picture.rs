use image::RgbImage;
use wm_bag::BagMessage;
use wm_msgs::sensor_msgs::{CompressedImage, Image};

/// The picture of a message as RGB.
pub(super) fn decode(message: &BagMessage) -> Result<RgbImage, String> {
    if *message.type_name == *"sensor_msgs/msg/Image" {
        let image = message
            .decode::<Image>()
            .map_err(|error| error.to_string())?;
        return raw(&image);
    }
    let image = message
        .decode::<CompressedImage>()
        .map_err(|error| error.to_string())?;
    let decoded = image::load_from_memory(&image.data)
        .map_err(|error| format!("format {:?}: {error}", image.format))?;
    Ok(decoded.into_rgb8())
}

fn raw(image: &Image) -> Result<RgbImage, String> {
    // Where red, green and blue are in a pixel, and how many bytes it has (sensor_msgs/image_encodings.hpp).
    let (order, pixel) = match image.encoding.as_str() {
        "rgb8" => ([0, 1, 2], 3),
        "bgr8" => ([2, 1, 0], 3),
        "rgba8" => ([0, 1, 2], 4),
        "bgra8" => ([2, 1, 0], 4),
        "mono8" => ([0, 0, 0], 1),
        other => {
            return Err(format!(
                "expected encoding rgb8, bgr8, rgba8, bgra8 or mono8, got {other:?}"
            ));
        }
    };
    let (width, step) = (image.width as usize, image.step as usize);
    let fits = width
        .checked_mul(pixel)
        .is_some_and(|row| row > 0 && row <= step)
        && step.checked_mul(image.height as usize) == Some(image.data.len());
    if !fits {
        return Err(format!(
            "expected {} x {} pixels of {pixel} bytes, got {} bytes in rows of {step}",
            image.width,
            image.height,
            image.data.len()
        ));
    }
    let rows = image
        .data
        .chunks_exact(step)
        .flat_map(|row| row.chunks_exact(pixel).take(width));
    let rgb = rows.flat_map(|pixel| order.map(|at| pixel.get(at).copied().unwrap_or(0)));
    RgbImage::from_raw(image.width, image.height, rgb.collect()).ok_or_else(|| {
        format!(
            "a picture of {} x {} does not fit its bytes",
            image.width, image.height
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_may_be_padded() {
        let image = |encoding: &str, step, data: Vec<u8>| Image {
            height: 2,
            width: 1,
            encoding: encoding.into(),
            step,
            data,
            ..Image::default()
        };
        let decoded = raw(&image("bgr8", 4, vec![1, 2, 3, 0, 4, 5, 6, 0])).unwrap();
        assert_eq!(decoded.into_raw(), [3, 2, 1, 6, 5, 4]);
        let decoded = raw(&image("mono8", 1, vec![7, 8])).unwrap();
        assert_eq!(decoded.into_raw(), [7, 7, 7, 8, 8, 8]);
        assert!(
            raw(&image("bgr8", 2, vec![0; 4]))
                .unwrap_err()
                .contains("expected 1 x 2 pixels")
        );
        assert!(
            raw(&image("rgb8", 3, vec![0; 5]))
                .unwrap_err()
                .contains("got 5 bytes")
        );
        assert!(
            raw(&image("yuv422", 3, vec![0; 6]))
                .unwrap_err()
                .contains("yuv422")
        );
    }
}
