#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use candle_core::Tensor;
use wm_model::LatentSpace;
use wm_msgs::{builtin_interfaces::Time, std_msgs::Header};

use super::*;
use wm_camera::image_message::{decode_compressed, decode_image};
use wm_wire::{
    latent_message::{LatentDtype, encode_latent},
    transport::{Pictures, Transports},
};

/// Each latent place is one pixel.
struct Pixels(LatentSpace);

impl Decoder for Pixels {
    fn space(&self) -> &LatentSpace {
        &self.0
    }

    fn output_size(&self) -> (usize, usize) {
        (2, 3)
    }

    fn decode(&self, latents: &Tensor) -> wm_model::Result<Tensor> {
        Ok(latents.clone())
    }
}

fn space(hash: &str) -> LatentSpace {
    LatentSpace {
        name: "pixels".into(),
        hash: hash.into(),
        height: 2,
        width: 3,
        channels: 3,
    }
}

fn prediction(hash: &str) -> Prediction {
    let header = Header {
        stamp: Time { sec: 9, nanosec: 4 },
        frame_id: "camera".into(),
    };
    let values: Vec<f32> = (0..18).map(|index| index as f32 / 17.0).collect();
    let latent = encode_latent(&values, &space(hash), LatentDtype::F32, header.clone()).unwrap();
    Prediction {
        header,
        latent,
        ..Prediction::default()
    }
}

#[test]
fn a_picture_has_the_stamp_of_its_prediction() {
    let step = DecoderStep::new(Box::new(Pixels(space("01"))));
    let prediction = prediction("01");
    let picture = step.decode(&prediction).unwrap();
    assert_eq!(
        picture.as_raw(),
        &(0..18_u8).map(|index| index * 15).collect::<Vec<_>>()
    );
    assert_eq!(step.raw_bytes(), picture.as_raw().len());

    let header = prediction.header.clone();
    let pictures = Pictures::encode(&picture, header, Transports::BOTH, 90).unwrap();
    let raw = pictures.raw.unwrap();
    assert_eq!((&raw.header, raw.step), (&prediction.header, 9));
    assert_eq!(decode_image(&raw).unwrap(), picture);
    let jpeg = pictures.compressed.unwrap();
    assert_eq!(
        (&jpeg.header, jpeg.format.as_str()),
        (&prediction.header, "jpeg")
    );
    assert_eq!(decode_compressed(&jpeg).unwrap().dimensions(), (3, 2));
}

#[test]
fn a_latent_of_another_space_is_refused() {
    let step = DecoderStep::new(Box::new(Pixels(space("01"))));
    let error = step.decode(&prediction("02")).unwrap_err();
    assert!(
        matches!(error, DecoderError::Latent(LatentError::Space { .. })),
        "{error}"
    );
}
