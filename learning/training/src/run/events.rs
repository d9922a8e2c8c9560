//! TensorBoard event files: TFRecords of `tensorflow.Event` messages (tensorflow/core/util/event.proto and
//! tensorflow/core/framework/summary.proto), with the parts for scalars and pictures.

use std::{
    fs::{self, File},
    io::{BufWriter, Cursor, Write as _},
    path::Path,
    time::{SystemTime, UNIX_EPOCH},
};

use anyhow::{Context as _, Result};
use image::{ImageFormat, RgbImage};
use prost::Message;
use wm_evaluation::Figure;

use super::StepLoss;

#[derive(Clone, PartialEq, Message)]
struct Event {
    #[prost(double, tag = "1")]
    wall_time: f64,
    #[prost(int64, tag = "2")]
    step: i64,
    #[prost(string, optional, tag = "3")]
    file_version: Option<String>,
    #[prost(message, optional, tag = "5")]
    summary: Option<Summary>,
}

#[derive(Clone, PartialEq, Message)]
struct Summary {
    #[prost(message, repeated, tag = "1")]
    value: Vec<Value>,
}

#[derive(Clone, PartialEq, Message)]
struct Value {
    #[prost(string, tag = "1")]
    tag: String,
    #[prost(float, optional, tag = "2")]
    simple_value: Option<f32>,
    #[prost(message, optional, tag = "4")]
    image: Option<Picture>,
}

#[derive(Clone, PartialEq, Message)]
struct Picture {
    #[prost(int32, tag = "1")]
    height: i32,
    #[prost(int32, tag = "2")]
    width: i32,
    /// 3 is RGB.
    #[prost(int32, tag = "3")]
    colorspace: i32,
    #[prost(bytes = "vec", tag = "4")]
    encoded_image_string: Vec<u8>,
}

/// Event file of one run of a training; each resumed run starts a further file.
pub(super) struct Events {
    file: BufWriter<File>,
}

impl Events {
    /// A new file in `OUT/NAME.events`, the folder for TensorBoard.
    pub(super) fn create(out: &Path, name: &str) -> Result<Self> {
        let folder = out.join(format!("{name}.events"));
        let now = now();
        let create = || -> std::io::Result<File> {
            fs::create_dir_all(&folder)?;
            File::create(folder.join(format!("events.out.tfevents.{:.0}.wm", now * 1e3)))
        };
        let file = create().with_context(|| folder.display().to_string())?;
        let mut events = Self {
            file: BufWriter::new(file),
        };
        events.write(&Event {
            wall_time: now,
            file_version: Some("brain.Event:2".into()),
            ..Event::default()
        })?;
        Ok(events)
    }

    /// Records a step.
    pub(super) fn step(&mut self, step: u64, found: &StepLoss, norm: f64, rate: f64) -> Result<()> {
        let own = [
            ("loss", f64::from(found.loss)),
            ("gradient_norm", norm),
            ("learning_rate", rate),
        ];
        let all = own.into_iter().chain(found.parts.iter().copied());
        let values = all.map(|(name, value)| scalar(format!("training/{name}"), value));
        self.summary(step, values.collect())
    }

    /// Records a validation.
    pub(super) fn validated(&mut self, step: u64, figures: &[Figure]) -> Result<()> {
        let figures = figures.iter();
        let values = figures.map(|f| scalar(format!("validation/{}", f.name), f.value));
        self.summary(step, values.collect())
    }

    /// Records samples of the model.
    pub(super) fn picture(&mut self, step: u64, picture: &RgbImage) -> Result<()> {
        let mut png = Cursor::new(Vec::new());
        picture.write_to(&mut png, ImageFormat::Png)?;
        let value = Value {
            tag: "samples".into(),
            image: Some(Picture {
                height: i32::try_from(picture.height())?,
                width: i32::try_from(picture.width())?,
                colorspace: 3,
                encoded_image_string: png.into_inner(),
            }),
            ..Value::default()
        };
        self.summary(step, vec![value])
    }

    pub(super) fn flush(&mut self) -> Result<()> {
        Ok(self.file.flush()?)
    }

    fn summary(&mut self, step: u64, value: Vec<Value>) -> Result<()> {
        self.write(&Event {
            wall_time: now(),
            step: i64::try_from(step)?,
            summary: Some(Summary { value }),
            ..Event::default()
        })
    }

    /// Writes a TFRecord: length, its checksum, the message, its checksum.
    fn write(&mut self, event: &Event) -> Result<()> {
        let message = event.encode_to_vec();
        let length = (message.len() as u64).to_le_bytes();
        for bytes in [&length[..], &message] {
            self.file.write_all(bytes)?;
            self.file.write_all(&masked(bytes).to_le_bytes())?;
        }
        Ok(())
    }
}

fn scalar(tag: String, value: f64) -> Value {
    Value {
        tag,
        simple_value: Some(value as f32),
        ..Value::default()
    }
}

/// The masked checksum of TFRecords (tensorflow/core/lib/hash/crc32c.h), which stays good for data with checksums inside.
fn masked(bytes: &[u8]) -> u32 {
    crc32c::crc32c(bytes)
        .rotate_right(15)
        .wrapping_add(0xa282_ead8)
}

fn now() -> f64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0.0, |since| since.as_secs_f64())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_round_trip() {
        let dir = tempfile::tempdir().unwrap();
        let mut events = Events::create(dir.path(), "a_run").unwrap();
        let found = StepLoss {
            loss: 0.5,
            parts: vec![("cosine", 0.25)],
            gradient: Vec::new(),
        };
        events.step(7, &found, 2.0, 1e-3).unwrap();
        events.validated(8, &[Figure::new("psnr", 30.0)]).unwrap();
        events.picture(8, &RgbImage::new(4, 2)).unwrap();
        events.flush().unwrap();
        let folder = fs::read_dir(dir.path().join("a_run.events")).unwrap();
        let path = folder.last().unwrap().unwrap().path();
        let bytes = fs::read(path).unwrap();

        let mut found = Vec::new();
        let mut rest = &bytes[..];
        while !rest.is_empty() {
            let (length, after) = rest.split_at(8);
            let (checksum, after) = after.split_at(4);
            assert_eq!(checksum, masked(length).to_le_bytes());
            let length = u64::from_le_bytes(length.try_into().unwrap()) as usize;
            let (message, after) = after.split_at(length);
            let (checksum, after) = after.split_at(4);
            assert_eq!(checksum, masked(message).to_le_bytes());
            found.push(Event::decode(message).unwrap());
            rest = after;
        }
        assert_eq!(found[0].file_version.as_deref(), Some("brain.Event:2"));
        let values = |event: &Event| {
            let values = event.summary.clone().unwrap().value.into_iter();
            values.map(|v| (v.tag, v.simple_value)).collect::<Vec<_>>()
        };
        assert_eq!(found[1].step, 7);
        assert_eq!(values(&found[1])[0], ("training/loss".into(), Some(0.5)));
        assert_eq!(values(&found[1])[3], ("training/cosine".into(), Some(0.25)));
        assert_eq!(values(&found[2]), [("validation/psnr".into(), Some(30.0))]);
        let summary = found[3].summary.clone().unwrap();
        let picture = summary.value[0].image.clone().unwrap();
        assert_eq!((picture.height, picture.width), (2, 4));
        assert!(image::load_from_memory(&picture.encoded_image_string).is_ok());
    }

    /// Check value of CRC-32C, RFC 3720 appendix B.4, 32 zero bytes.
    #[test]
    fn checksum_matches_tfrecords() {
        let crc: u32 = 0x8a91_36aa;
        let expected = crc.rotate_right(15).wrapping_add(0xa282_ead8);
        assert_eq!(masked(&[0; 32]), expected);
    }
}
