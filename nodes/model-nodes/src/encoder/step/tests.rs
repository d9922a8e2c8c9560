#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use candle_core::Tensor;
use wm_model::LatentSpace;
use wm_msgs::{builtin_interfaces::Time, sensor_msgs::Image};

use super::*;
use wm_camera::image_message::{encode_image, encode_jpeg};
use wm_wire::latent_message::decode_latent;

/// The mean colour of each 4x4 block: an encoder whose latents can be checked by hand.
struct BlockMeans(LatentSpace);

impl Encoder for BlockMeans {
    fn space(&self) -> &LatentSpace {
        &self.0
    }

    fn input_size(&self) -> (usize, usize) {
        (8, 8)
    }

    fn encode(&self, images: &Tensor) -> wm_model::Result<Tensor> {
        let blocks = images.reshape(&[1, 2, 4, 2, 4, 3][..])?;
        Ok(blocks.mean(4)?.mean(2)?)
    }
}

fn step(dtype: LatentDtype) -> EncoderStep {
    let space = LatentSpace {
        name: "means".into(),
        hash: "01".into(),
        height: 2,
        width: 2,
        channels: 3,
    };
    EncoderStep::new(Box::new(BlockMeans(space)), dtype)
}

fn header() -> Header {
    Header {
        stamp: Time { sec: 7, nanosec: 5 },
        frame_id: "camera".into(),
    }
}

/// Red on the left, green on the right; 8x8.
fn picture() -> RgbImage {
    RgbImage::from_fn(8, 8, |x, _| {
        if x < 4 {
            image::Rgb([255, 0, 0])
        } else {
            image::Rgb([0, 255, 0])
        }
    })
}

const EXPECTED: [f32; 12] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];

#[test]
fn incomplete_or_depth_picture_has_no_latent() {
    let whole = encode_jpeg(&picture(), header(), 90).unwrap();
    let step = step(LatentDtype::F32);
    let compressed = |data: &[u8]| {
        let mut image = whole.clone();
        image.data = data.to_vec();
        CameraFrame::Compressed(image)
    };
    step.encode(&compressed(&whole.data)).unwrap();
    let cut = step.encode(&compressed(&whole.data[..whole.data.len() - 5]));
    let text = cut.unwrap_err().to_string();
    assert!(text.contains("incomplete"), "{text}");
    let depth = Image {
        encoding: "mono16".into(),
        step: 16,
        data: vec![3; 16 * 8],
        ..encode_image(&picture(), header())
    };
    let text = step
        .encode(&CameraFrame::Raw(depth))
        .unwrap_err()
        .to_string();
    assert!(text.contains("depth"), "{text}");
}

#[test]
fn a_frame_becomes_the_latent_of_its_stamp() {
    let frame = CameraFrame::Raw(encode_image(&picture(), header()));
    for dtype in [LatentDtype::F32, LatentDtype::F16, LatentDtype::Bf16] {
        let step = step(dtype);
        let latent = step.encode(&frame).unwrap();
        assert_eq!(latent.header, header());
        assert_eq!(decode_latent(&latent, step.space()).unwrap(), EXPECTED);
    }
}

#[test]
fn both_transports_and_any_size_give_the_same_latent() {
    let large = image::imageops::resize(&picture(), 32, 32, image::imageops::FilterType::Nearest);
    let frame = CameraFrame::Compressed(encode_jpeg(&large, header(), 95).unwrap());
    let values = step(LatentDtype::F32)
        .encode_values(&frame.decode().unwrap())
        .unwrap();
    for (value, expected) in values.iter().zip(EXPECTED) {
        // JPEG's colour is coarse at the edge.
        assert!((value - expected).abs() < 0.06, "{values:?}");
    }
}

#[test]
fn a_malformed_frame_is_an_error_that_names_it() {
    let frame = CameraFrame::Raw(Image {
        encoding: "bayer_rggb16".into(),
        ..encode_image(&picture(), header())
    });
    let error = step(LatentDtype::F16).encode(&frame).unwrap_err();
    assert!(error.to_string().contains("\"bayer_rggb16\""), "{error}");
}
