//! Checks whether a model fits camera and machine.

use crate::{Camera, DoctorError, Finding, Parts, Picture, Trial};
use std::time::Duration;
use wm_model::{Framing, PictureSize};
use wm_model_nodes::cadence::hertz;
use wm_model_nodes::encoder::Mismatch;
use wm_model_nodes::predictor::{UNLIKE, part_far_out};
use wm_motion::actions::ActionSpace;
use wm_ros::logging::of_others;
use wm_zoo::ModelFolder;

const CHECK: &str = "model";
/// The predictor's default `horizon` \[model steps\].
const HORIZON: u32 = 8;
/// The rate if neither a camera nor the model specifies one \[Hz\].
const USUAL_RATE: f64 = ActionSpace::BRIDGE_RATE;

/// Facts about a model, and how it encodes the camera's pictures.
#[derive(Clone, Debug)]
pub struct ModelFacts {
    /// The name given by the user.
    pub name: String,
    /// How its encoder frames pictures.
    pub framing: Framing,
    /// Size of the camera's pictures that it was trained on, if known.
    pub trained_on: Option<PictureSize>,
    /// Its action space with the rate; `None` without a transition model.
    pub action_space: Option<ActionSpace>,
    /// Durations of its parts on this machine.
    pub trial: Trial,
    /// Share of latent values of the camera's pictures that are far from the training's; `None` without pictures.
    pub far_out: Option<f32>,
}

/// Opens, loads and runs a model, and encodes `pictures` with it.
///
/// # Errors
/// It cannot be opened, or a part fails.
pub fn gather(name: &str, pictures: &[&Picture]) -> Result<ModelFacts, DoctorError> {
    let model = ModelFolder::open(name).map_err(DoctorError::of("the model"))?;
    let parts = Parts::load(&model)?;
    let trial = parts.try_out()?;
    let framing = model.framing().map_err(DoctorError::of("the model"))?;
    let encode = |picture: &Picture| -> wm_zoo::Result<f32> {
        let image = framing.tensor(&picture.pixels)?;
        Ok(part_far_out(&parts.encoder.values(&image)?))
    };
    let mut sum = 0.0;
    for picture in pictures {
        sum += encode(picture).map_err(DoctorError::of("encoding the camera's pictures"))?;
    }
    Ok(ModelFacts {
        name: model.name(),
        framing,
        trained_on: model.trained_on().map_err(DoctorError::of("the model"))?,
        action_space: parts.transition.map(|model| model.encoding.space().clone()),
        trial,
        far_out: (!pictures.is_empty()).then(|| sum / pictures.len() as f32),
    })
}

impl ModelFacts {
    /// Time between camera frames in training \[s\].
    pub(crate) fn period_s(&self) -> f64 {
        1.0 / self
            .action_space
            .as_ref()
            .map_or(USUAL_RATE, ActionSpace::rate)
    }

    /// The `frame_period` that the nodes need for a camera with `camera_s` between frames; `None` if their default, the
    /// model's, suffices \[s\].
    pub(crate) fn frame_period_s(&self, camera_s: f64) -> Option<f64> {
        let is_slower = camera_s > 1.25 * self.period_s();
        is_slower.then_some(camera_s)
    }
}

/// The findings for the camera of this name.
pub(crate) fn check(model: &ModelFacts, camera: Option<(&str, &Camera)>) -> Vec<Finding> {
    let mut findings = Vec::new();
    if model.action_space.is_none() {
        findings.push(
            Finding::warning(CHECK, format!("{} has no transition model", model.name))
                .because(
                    "it only encodes and decodes: predictor, planner and evaluator do not start",
                )
                .fix("train one (docs/models.md), or resume a stopped training"),
        );
    }
    let stream = camera.and_then(|(_, camera)| camera.best());
    let camera_s = stream.and_then(|stream| stream.timeline.picture_period_s());
    findings.push(speed(model, camera_s));
    if let Some(camera_s) = camera_s {
        findings.extend(rate(model, camera_s));
    }
    if let Some((name, camera)) = camera {
        findings.extend(pictures(model, &of_others(name), camera));
    }
    findings
}

/// Whether this machine is fast enough. The nodes need frames no more often than the model was trained with.
fn speed(model: &ModelFacts, camera_s: Option<f64>) -> Finding {
    let period_s = camera_s.map_or(model.period_s(), |camera_s| camera_s.max(model.period_s()));
    let times = model.trial.at(Duration::from_secs_f64(period_s));
    let text = times.to_string();
    // without parts, the text is the verdict alone
    let (parts, verdict) = text.rsplit_once('\n').unwrap_or(("", &text));
    let what = format!("{}: {verdict}", model.name);
    match times.is_fast_enough() {
        true => Finding::ok(CHECK, what),
        false => Finding::warning(CHECK, what)
            .because(parts.replace('\n', "; "))
            .fix("a smaller model, a lower horizon, fewer integration_steps, or a faster processor (docs/models.md#slower-than-the-camera)"),
    }
}

/// Whether frames exist at the times that the model needs.
fn rate(model: &ModelFacts, camera_s: f64) -> Option<Finding> {
    let model_s = model.period_s();
    let hertz = |period_s| hertz(Duration::from_secs_f64(period_s));
    let (camera_hz, model_hz) = (hertz(camera_s), hertz(model_s));
    if model.frame_period_s(camera_s).is_some() {
        return Some(
            Finding::warning(CHECK, format!("the camera runs at {camera_hz}, the model was trained at {model_hz}"))
                .because("the nodes need a frame every 0.2 s and find none; with another period, motions have lengths that the model has not seen")
                .fix(format!("let the camera publish at {model_hz} or faster; or frame_period:={camera_s:.3} on encoder, predictor, planner and evaluator (wm init DIR writes it)")),
        );
    }
    let step_s = model_s * model.trial.frame_skip as f64;
    let is_missed = |step: &u32| {
        let wanted_s = step_s * f64::from(*step);
        let nearest_s = (wanted_s / camera_s).round() * camera_s;
        (nearest_s - wanted_s).abs() > model_s / 4.0
    };
    let missed: Vec<u32> = (1..=HORIZON).filter(is_missed).collect();
    let fits = format!("the camera runs at {camera_hz}, the model was trained at {model_hz}");
    let fix = format!("let the camera publish at {model_hz} or a multiple of it");
    match missed.first() {
        None => None,
        // the context is one model step long
        Some(1) => Some(
            Finding::warning(CHECK, fits)
                .because(format!("no frame is {step_s:.1} s earlier than another: contexts stay incomplete, and there are no predictions"))
                .fix(fix),
        ),
        Some(_) => Some(
            Finding::note(CHECK, fits)
                .because(format!("{} of {HORIZON} predicted steps have no frame near their time, and are not scored", missed.len()))
                .fix(fix),
        ),
    }
}

/// Whether the pictures resemble those of the training.
fn pictures(model: &ModelFacts, name: &str, camera: &Camera) -> Vec<Finding> {
    let mut findings = Vec::new();
    let pictures: Vec<&Picture> = camera.pictures.iter().flatten().collect();
    let Some(first) = pictures.first() else {
        return findings;
    };
    let (rows, columns) = model.framing.size;
    let (width, height) = first.size;
    findings.extend(size(model, name, PictureSize { width, height }));
    if (width as usize) < columns || (height as usize) < rows {
        findings.push(
            Finding::warning(CHECK, format!("{name}: pictures of {width}x{height} are enlarged to the model's {columns}x{rows}"))
                .because("they have less detail than the training's")
                .fix("let the driver publish a larger size"),
        );
    }
    let Some(far_out) = model.far_out else {
        return findings;
    };
    let count = pictures.len() as f64;
    let mean = pictures.iter().map(|picture| picture.mean).sum::<f64>() / count;
    let spread = pictures.iter().map(|picture| picture.spread).sum::<f64>() / count;
    let what = format!(
        "{name}: {:.1} % of the latents' values are far from the training's ({} pictures, mean {mean:.2}, spread {spread:.2})",
        100.0 * far_out,
        pictures.len()
    );
    findings.push(match far_out > UNLIKE {
        false => Finding::ok(CHECK, what),
        true => Finding::warning(CHECK, what)
            .because("the pictures differ from the training's (beyond 3 standard deviations, where 0.3 % are usual): predictions and plans are not meaningful")
            .fix("a model that was trained on such pictures: wm train model --data BAGS --out DIR, then model:=DIR (README, Your model)"),
    });
    findings
}

/// Whether the pictures have the aspect ratio and size of the training.
fn size(model: &ModelFacts, name: &str, found: PictureSize) -> Option<Finding> {
    let mismatch = Mismatch::of(found, model.framing, model.trained_on)?;
    let what = format!("{name}: {mismatch}");
    Some(match mismatch.is_serious() {
        true => Finding::warning(CHECK, what)
            .because("the model has not seen objects in these shapes or places")
            .fix(mismatch.fix()),
        false => Finding::note(CHECK, what).fix(mismatch.fix()),
    })
}

/// A fast test model: 5 Hz, two frames per step.
#[cfg(test)]
pub(crate) fn facts() -> ModelFacts {
    ModelFacts {
        name: "tiny".into(),
        framing: Framing::from((64, 64)),
        trained_on: None,
        action_space: Some(ActionSpace::bridge()),
        trial: Trial {
            encode: Duration::from_millis(5),
            predict: Some(Duration::from_millis(15)),
            decode: Some(Duration::from_millis(5)),
            judge: None,
            frame_skip: 2,
        },
        far_out: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Level, Stream, timeline::regular};
    use image::RgbImage;

    fn camera(period_ms: u64, side: u32) -> Camera {
        let stream = Stream {
            timeline: regular(12, period_ms, 0),
            ..Stream::default()
        };
        Camera {
            raw: Some(stream),
            pictures: vec![Ok(Picture::of(RgbImage::new(side, side)))],
            ..Camera::default()
        }
    }

    fn found(model: &ModelFacts, period_ms: u64) -> Vec<(Level, String)> {
        let findings = check(model, Some(("/c", &camera(period_ms, 128))));
        let text = |finding: Finding| (finding.level, format!("{finding:?}"));
        findings.into_iter().map(text).collect()
    }

    #[test]
    fn multiples_of_the_models_rate_fit() {
        for period_ms in [200, 100, 67, 33, 20] {
            let found = found(&facts(), period_ms);
            assert_eq!(found.len(), 1, "{period_ms} ms: {found:?}");
            assert_eq!(found[0].0, Level::Ok);
        }
    }

    #[test]
    fn slow_camera_gets_its_frame_period() {
        let slow = &found(&facts(), 500)[1];
        assert_eq!(slow.0, Level::Warning);
        assert!(slow.1.contains("frame_period:=0.500"), "{slow:?}");
        assert_eq!(facts().frame_period_s(0.5), Some(0.5));
        assert_eq!(facts().frame_period_s(0.21), None);
    }

    #[test]
    fn rate_between_two_multiples_is_reported() {
        // 6.1 Hz: frames 0.328 s and 0.492 s earlier, none near 0.4 s.
        let between = &found(&facts(), 164)[1];
        assert_eq!(between.0, Level::Warning, "{between:?}");
        // 7 Hz: 0.429 s earlier is a valid context, but no frame is near 1.2 s later.
        let partly = &found(&facts(), 143)[1];
        assert_eq!(partly.0, Level::Note, "{partly:?}");
    }

    #[test]
    fn slow_machine_is_a_warning() {
        let mut slow = facts();
        slow.trial.predict = Some(Duration::from_millis(400));
        let slow = &found(&slow, 200)[0];
        assert_eq!(slow.0, Level::Warning);
        assert!(slow.1.contains("too slow for 5 Hz"), "{slow:?}");
    }

    #[test]
    fn unfamiliar_and_small_pictures_are_reported() {
        let mut real = facts();
        real.far_out = Some(0.05);
        assert!(found(&real, 200)[1].1.contains("5.0 % of the latents"));
        assert_eq!(found(&real, 200)[1].0, Level::Warning);
        let mut own = facts();
        own.far_out = Some(0.004);
        assert_eq!(found(&own, 200)[1].0, Level::Ok);
        let small = check(&facts(), Some(("/c", &camera(200, 32))));
        assert!(small[1].what.contains("32x32 are enlarged"), "{small:?}");
    }

    #[test]
    fn aspect_ratio_unlike_the_trainings_is_a_warning() {
        let mut own = facts();
        let size = |width, height| Some(PictureSize { width, height });
        // the test camera has 128x128 pixels
        own.trained_on = size(640, 480);
        let found = check(&own, Some(("/c", &camera(200, 128))));
        assert_eq!(found[1].level, Level::Warning);
        let text = &found[1].what;
        assert!(
            text.contains("128x128") && text.contains("640x480"),
            "{text}"
        );
        own.trained_on = size(256, 256);
        assert_eq!(
            check(&own, Some(("/c", &camera(200, 128))))[1].level,
            Level::Note
        );
        own.trained_on = size(128, 128);
        assert_eq!(check(&own, Some(("/c", &camera(200, 128)))).len(), 1);
    }

    #[test]
    fn bundled_model_flags_unfamiliar_pictures() {
        let mut state = 1u32;
        let mut colour = || {
            image::Rgb(std::array::from_fn(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 24) as u8
            }))
        };
        // patches as large as objects: averaging removes noise of single pixels
        let patches: Vec<_> = (0..64).map(|_| colour()).collect();
        let patch = |x: u32, y: u32| patches[(y / 16 * 8 + x / 16) as usize];
        let picture = RgbImage::from_fn(128, 128, patch);
        let facts = gather("tiny", &[&Picture::of(picture)]).unwrap();
        assert!(facts.far_out.unwrap() > UNLIKE, "{facts:?}");
        assert_eq!(facts.period_s(), 0.2);
        assert!(facts.trial.predict.is_some() && facts.trial.decode.is_some());
        assert!(gather("/nope", &[]).is_err());
    }
}
