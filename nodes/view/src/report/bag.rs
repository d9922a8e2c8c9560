//! Scores a recorded bag like a live stream: log times are the arrival times.

use super::Scorer;
use anyhow::{Context as _, Result, bail};
use std::collections::BTreeMap;
use std::path::Path;
use wm_bag::{BagMessage, BagReader};
use wm_camera::camera_frame::CameraFrame;
use wm_model::Fit;
use wm_msgs::{
    diagnostic_msgs::DiagnosticArray,
    std_msgs::String as Text,
    wm_msgs::{Plan, Prediction, PredictionError},
};

/// The topics of a bag that are scored.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct BagTopics {
    /// Camera frames, raw or compressed.
    pub camera: String,
    pub predicted: String,
    /// Pictures of the predictions, raw or compressed.
    pub pictures: String,
    /// How the model frames pictures of another aspect ratio.
    pub fit: String,
    /// Latent errors of the predictions.
    pub errors: String,
    pub plans: String,
    pub diagnostics: String,
}

impl BagTopics {
    /// The suite's default topics. For camera and pictures: the raw topic if the bag has it, otherwise the compressed
    /// one.
    fn of(reader: &BagReader) -> Result<Self> {
        let pick = |raw: &str| {
            let compressed = format!("{raw}/compressed");
            let has = |name: &str| {
                reader
                    .topic(name)
                    .is_some_and(|topic| topic.message_count > 0)
            };
            if has(raw) || !has(&compressed) {
                raw.to_owned()
            } else {
                compressed
            }
        };
        let topics = Self {
            camera: pick("/camera/image_raw"),
            predicted: "/wm/predicted".to_owned(),
            pictures: pick("/wm/predicted/image"),
            fit: "/wm/predicted/fit".to_owned(),
            errors: "/wm/prediction_error".to_owned(),
            plans: "/wm/plan".to_owned(),
            diagnostics: "/diagnostics".to_owned(),
        };
        if reader.message_count() == 0 {
            bail!("the bag has no readable messages");
        }
        for needed in [&topics.camera, &topics.predicted] {
            if reader.topic(needed).is_none() {
                let names: Vec<&str> = reader
                    .topics()
                    .iter()
                    .map(|topic| topic.name.as_ref())
                    .collect();
                bail!(
                    "the bag has no topic {needed}; its topics: {}",
                    names.join(", ")
                );
            }
        }
        Ok(topics)
    }
}

/// Messages that cannot be scored: their number by topic, and one reason.
pub(crate) type Unreadable = BTreeMap<String, (u64, String)>;

/// Scores the bag at `path`.
///
/// # Errors
/// The bag cannot be read, or has no camera or no predictions. Single unreadable messages are counted.
pub fn score_bag(path: &Path) -> Result<(Scorer, Unreadable)> {
    let reader = BagReader::open(path)?;
    let topics = BagTopics::of(&reader).with_context(|| format!("bag {}", path.display()))?;
    let mut scorer = Scorer::default();
    let mut unreadable = Unreadable::new();
    for message in reader.messages() {
        let (topic, result) = match message {
            Ok(message) => (
                message.topic.to_string(),
                score(&mut scorer, &topics, &message),
            ),
            Err(problem) => ("(the bag)".to_owned(), Err(problem.into())),
        };
        if let Err(problem) = result {
            let (count, _) = unreadable
                .entry(topic)
                .or_insert_with(|| (0, format!("{problem:#}")));
            *count += 1;
        }
    }
    Ok((scorer, unreadable))
}

fn score(scorer: &mut Scorer, topics: &BagTopics, message: &BagMessage) -> Result<()> {
    let topic = message.topic.as_ref();
    // log times beyond the year 2262 are invalid
    let arrived_ns = i64::try_from(message.log_time_ns).unwrap_or(i64::MAX);
    if topic == topics.camera {
        let (stamp_ns, frame) = picture_of(message)?;
        scorer.frame(stamp_ns, frame);
    } else if topic == topics.pictures {
        let (stamp_ns, picture) = picture_of(message)?;
        scorer.picture(stamp_ns, picture, arrived_ns);
    } else if topic == topics.predicted {
        scorer.prediction(&message.decode::<Prediction>()?, arrived_ns);
    } else if topic == topics.fit {
        scorer.fit(fit_of(&message.decode()?)?);
    } else if topic == topics.errors {
        scorer.error(&message.decode::<PredictionError>()?);
    } else if topic == topics.plans {
        scorer.plan(&message.decode::<Plan>()?);
    } else if topic == topics.diagnostics {
        scorer.diagnostics(&message.decode::<DiagnosticArray>()?);
    }
    Ok(())
}

/// The fit that a message names.
pub(crate) fn fit_of(message: &Text) -> Result<Fit> {
    message.data.parse().map_err(anyhow::Error::msg)
}

fn picture_of(message: &BagMessage) -> Result<(i64, image::RgbImage)> {
    let frame = CameraFrame::of_bag(message)?;
    Ok((frame.header().stamp.to_nanos(), frame.decode()?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::files::write_report;
    use image::{Rgb, RgbImage};
    use wm_bag::{BagWriter, WriterOptions};
    use wm_camera::image_message::encode_image;
    use wm_msgs::{
        builtin_interfaces::{Duration, Time},
        sensor_msgs::Image,
        std_msgs::{self, Header},
    };

    const STEP_NS: i64 = 400_000_000;

    fn header(stamp_ns: i64) -> Header {
        Header {
            stamp: Time::from_nanos(stamp_ns),
            ..Header::default()
        }
    }

    #[test]
    fn recorded_bag_is_scored_and_its_files_are_written() {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("bag");
        let mut writer = BagWriter::create(&bag, WriterOptions::default()).unwrap();
        let grey = |level: u8, side| RgbImage::from_pixel(side, side, Rgb([level; 3]));
        for frame in 0..5_i64 {
            let now = (frame + 1) * STEP_NS;
            let at = |after: i64| u64::try_from(now + after).unwrap();
            let level = 100 + 10 * frame as u8;
            writer
                .write(
                    "/camera/image_raw",
                    &encode_image(&grey(level, 32), header(now)),
                    at(0),
                )
                .unwrap();
            let prediction = Prediction {
                header: header(now + STEP_NS),
                observed_stamp: Time::from_nanos(now),
                step: 1,
                horizon: 1,
                step_period: Duration::from_nanos(STEP_NS),
                ..Prediction::default()
            };
            writer
                .write("/wm/predicted", &prediction, at(20_000_000))
                .unwrap();
            let picture = encode_image(&grey(level + 11, 16), header(now + STEP_NS));
            writer
                .write("/wm/predicted/image", &picture, at(30_000_000))
                .unwrap();
        }
        let broken = Image {
            encoding: "bayer".to_owned(),
            ..encode_image(&grey(0, 8), header(1))
        };
        writer
            .write(
                "/camera/image_raw",
                &broken,
                u64::try_from(9 * STEP_NS).unwrap(),
            )
            .unwrap();
        writer.finish().unwrap();

        let (scorer, unreadable) = score_bag(&bag).unwrap();
        assert!(
            unreadable["/camera/image_raw"].1.contains("bayer"),
            "{unreadable:?}"
        );
        let out = folder.path().join("out");
        let (report, files) = write_report(&scorer, "bag", &out).unwrap();
        assert_eq!(files.len(), 3);
        let decibel = |levels: f64| 20.0 * (255.0 / levels).log10();
        let step = &report.steps[0];
        assert_eq!(step.compared, 4);
        assert!((step.psnr_db.unwrap() - decibel(1.0)).abs() < 1e-9);
        assert!((step.persistence_psnr_db.unwrap() - decibel(10.0)).abs() < 1e-9);
        assert!((step.received_latency.unwrap().p50_ms - 20.0).abs() < 0.3);
        let json: serde_json::Value =
            serde_json::from_slice(&std::fs::read(out.join("report.json")).unwrap()).unwrap();
        assert_eq!(json["steps"][0]["n"], 4);
        assert_eq!(json["frames"], 5);
        assert!(image::open(out.join("strip.png")).is_ok());
    }

    #[test]
    fn bag_without_camera_is_an_error_with_the_topic() {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("bag");
        let mut writer = BagWriter::create(&bag, WriterOptions::default()).unwrap();
        writer
            .write("/note", &std_msgs::String::default(), 1)
            .unwrap();
        writer.finish().unwrap();
        let error = format!("{:#}", score_bag(&bag).unwrap_err());
        assert!(
            error.contains("/camera/image_raw") && error.contains("/note"),
            "{error}"
        );
    }

    #[test]
    fn error_names_a_missing_bag_once() {
        let error = format!("{:#}", score_bag(Path::new("/no/such/bag")).unwrap_err());
        assert_eq!(error.matches("/no/such/bag").count(), 1, "{error}");
    }
}
