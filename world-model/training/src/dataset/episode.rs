use std::path::Path;

use image::{GrayImage, RgbImage, imageops::FilterType};
use wm_bag::{BagMessage, BagReader};
use wm_camera::camera_frame::CameraFrame;
use wm_motion::{
    actions::ActionSpace,
    motion::{Motion, MotionSettings, Pace},
};
use wm_msgs::{sensor_msgs::CompressedImage, wm_msgs::Action};

use super::DatasetError;

const COMPRESSED: &str = "/camera/image_raw/compressed";
const RAW: &str = "/camera/image_raw";
const MASK: &str = "/camera/mask/compressed";
const ACTION: &str = "/wm/action";

/// The decoded pictures and actions of one bag.
pub(super) struct Decoded {
    /// Frames one after another, height x width x 3 bytes each.
    pub frames: Vec<u8>,
    /// Masks one after another, height x width bytes each; empty where the bag has none.
    pub masks: Vec<u8>,
    /// What the robot does from each frame to the next, in the units of the action space.
    pub actions: Vec<Vec<f32>>,
}

/// Decodes the frames of `bag` at `size` (height, width), at the rate of the action space, with what the robot does from
/// each to the next.
pub(super) fn decode(
    reader: &BagReader,
    bag: &Path,
    size: (usize, usize),
    space: &ActionSpace,
) -> Result<Decoded, DatasetError> {
    let refused = |what: String| DatasetError::Episode {
        bag: bag.to_owned(),
        what,
    };
    // A camera that publishes both sends each frame twice.
    let has_frames = |name: &str| {
        let mut topics = reader.topics().iter();
        topics.any(|topic| &*topic.name == name && topic.message_count > 0)
    };
    let camera = if has_frames(COMPRESSED) {
        COMPRESSED
    } else {
        RAW
    };
    let mut frames: Vec<(i64, Vec<u8>)> = Vec::new();
    let mut masks = Vec::new();
    let mut actions: Vec<(i64, Vec<f32>)> = Vec::new();
    for message in reader.messages().only_topics([camera, MASK, ACTION]) {
        let message = message.map_err(|source| DatasetError::Bag {
            bag: bag.to_owned(),
            source: Box::new(source),
        })?;
        let undecodable = |what: String| {
            refused(format!(
                "{} at {} ns: {what}",
                message.topic, message.log_time_ns
            ))
        };
        match &*message.topic {
            ACTION => {
                let action: Action = message.decode().map_err(|e| undecodable(e.to_string()))?;
                space
                    .check(&action.values)
                    .map_err(|e| undecodable(e.to_string()))?;
                actions.push((action.header.stamp.to_nanos(), action.values));
            }
            MASK => {
                masks.extend(shrink_mask(&mask(&message).map_err(undecodable)?, size));
            }
            _ => {
                let (stamp, picture) = frame(&message).map_err(undecodable)?;
                let resized = wm_model::image::resize(&picture, size)
                    .map_err(|error| undecodable(error.to_string()))?;
                frames.push((stamp, resized.into_raw()));
            }
        }
    }
    if frames.is_empty() {
        return Err(refused(format!(
            "no camera: expected frames on {COMPRESSED} or {RAW}"
        )));
    }
    if !masks.is_empty() && masks.len() != frames.len() * size.0 * size.1 {
        let count = masks.len() / (size.0 * size.1);
        return Err(refused(format!(
            "{count} masks for {} frames",
            frames.len()
        )));
    }
    let stamps: Vec<i64> = frames.iter().map(|(stamp_ns, _)| *stamp_ns).collect();
    let kept = thinned(&stamps, space).map_err(refused)?;
    let stamps: Vec<i64> = kept
        .iter()
        .filter_map(|index| stamps.get(*index).copied())
        .collect();
    let actions = align(&stamps, space, actions).map_err(refused)?;
    let mask_bytes = size.0 * size.1;
    let masks: Vec<&[u8]> = masks.chunks_exact(mask_bytes).collect();
    let of_kept = |index: &usize| masks.get(*index).copied().unwrap_or_default();
    Ok(Decoded {
        frames: kept
            .iter()
            .filter_map(|index| frames.get(*index))
            .flat_map(|(_, frame)| frame.iter().copied())
            .collect(),
        masks: kept.iter().flat_map(of_kept).copied().collect(),
        actions,
    })
}

/// The action space of a bag.
pub(super) fn action_space(reader: &BagReader, bag: &Path) -> Result<ActionSpace, DatasetError> {
    ActionSpace::of_note(reader.note(ActionSpace::NOTE)).map_err(|error| DatasetError::Episode {
        bag: bag.to_owned(),
        what: error.to_string(),
    })
}

/// Indices of the frames that are a period of the action space's rate apart: all of them, or, of a faster camera, as
/// many as a model sees.
fn thinned(stamps: &[i64], space: &ActionSpace) -> Result<Vec<usize>, String> {
    let mut gaps = Vec::with_capacity(stamps.len());
    for (before, after) in stamps.iter().zip(stamps.iter().skip(1)) {
        if after <= before {
            return Err(format!(
                "camera stamps do not increase: {after} ns follows {before} ns"
            ));
        }
        gaps.push(after - before);
    }
    // The median: a jittery pair of frames says nothing of the rate.
    gaps.sort_unstable();
    // A rate is at least 0.01 Hz.
    let period_ns = (1e9 / space.rate()) as i64;
    let gap_ns = gaps.get(gaps.len() / 2).copied().unwrap_or(period_ns);
    if gap_ns > period_ns + period_ns / 2 {
        return Err(format!(
            "the camera has a frame every {:.2} s, but actions of {} Hz need one every {:.2} s",
            gap_ns as f64 / 1e9,
            space.rate(),
            period_ns as f64 / 1e9
        ));
    }
    // Of a fast camera the frame that is nearest to its time is kept; stamps of any other jitter.
    let mut pace = Pace::new(period_ns, gap_ns);
    let kept = stamps.iter().enumerate();
    let kept = kept.filter(|(_, stamp_ns)| pace.is_due(**stamp_ns));
    Ok(kept.map(|(index, _)| index).collect())
}

/// What the robot does from each of these moments to the next; after the last one the motion goes on for as long.
fn align(
    stamps: &[i64],
    space: &ActionSpace,
    actions: Vec<(i64, Vec<f32>)>,
) -> Result<Vec<Vec<f32>>, String> {
    if actions.is_empty() {
        return Err(format!("no actions: expected messages on {ACTION}"));
    }
    let period_ns = (1e9 / space.rate()) as i64;
    let mut motion = Motion::new(MotionSettings {
        keep_ns: i64::MAX,
        ..MotionSettings::of_period(period_ns)
    });
    // In parts, so that no episode is too long for what a motion keeps.
    let mut actions = actions.into_iter().peekable();
    let mut aligned = Vec::with_capacity(stamps.len());
    for (index, stamp_ns) in stamps.iter().enumerate() {
        let end_ns = match stamps.get(index + 1) {
            Some(next_ns) => *next_ns,
            None => stamp_ns.saturating_add(period_ns),
        };
        while let Some((at_ns, values)) =
            actions.next_if(|(at_ns, _)| *at_ns <= end_ns.saturating_add(period_ns))
        {
            motion.take(at_ns, values.into());
        }
        let Some(interval) = motion.between(space, *stamp_ns, end_ns) else {
            return Err(format!(
                "no message on {ACTION} at or before the frame at {stamp_ns} ns"
            ));
        };
        // After the last frame nothing need be done any more: some data sets record no action for it.
        if !interval.is_given && index + 1 < stamps.len() {
            return Err(format!(
                "no message on {ACTION} within a period of the frame at {stamp_ns} ns"
            ));
        }
        aligned.push(interval.values);
    }
    Ok(aligned)
}

fn mask(message: &BagMessage) -> Result<GrayImage, String> {
    let mask: CompressedImage = message.decode().map_err(|error| error.to_string())?;
    let decoded = image::load_from_memory(&mask.data).map_err(|error| error.to_string())?;
    Ok(decoded.into_luma8())
}

fn frame(message: &BagMessage) -> Result<(i64, RgbImage), String> {
    let frame = CameraFrame::of_bag(message).map_err(|error| error.to_string())?;
    let picture = frame.decode().map_err(|error| error.to_string())?;
    Ok((frame.header().stamp.to_nanos(), picture))
}

/// Class numbers may not be blended: nearest neighbour.
fn shrink_mask(mask: &GrayImage, (h, w): (usize, usize)) -> Vec<u8> {
    image::imageops::resize(mask, w as u32, h as u32, FilterType::Nearest).into_raw()
}
