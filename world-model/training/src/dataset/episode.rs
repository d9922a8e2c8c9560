use std::path::Path;

use image::{GrayImage, RgbImage, imageops::FilterType};
use wm_bag::{BagMessage, BagReader};
use wm_msgs::{sensor_msgs::CompressedImage, sensor_msgs::Image, wm_msgs::Action};

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
    /// One action a frame.
    pub actions: Vec<[f32; 7]>,
}

/// Decodes every frame of `bag` at `size` (height, width) and gives each the action taken at its time: the nearest in
/// time, at most half a frame period away.
pub(super) fn decode(
    reader: &BagReader,
    bag: &Path,
    size: (usize, usize),
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
    let mut actions: Vec<(i64, [f32; 7])> = Vec::new();
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
                let values = wm_model::actions::physical(&action.values)
                    .map_err(|e| undecodable(e.to_string()))?;
                actions.push((action.header.stamp.to_nanos(), values));
            }
            MASK => {
                let mask = compressed(&message).map_err(undecodable)?.1.into_luma8();
                masks.extend(shrink_mask(&mask, size));
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
    let actions = align(&frames, &actions).map_err(refused)?;
    Ok(Decoded {
        frames: frames.into_iter().flat_map(|(_, frame)| frame).collect(),
        masks,
        actions,
    })
}

fn align(frames: &[(i64, Vec<u8>)], actions: &[(i64, [f32; 7])]) -> Result<Vec<[f32; 7]>, String> {
    if actions.is_empty() {
        return Err(format!("no actions: expected messages on {ACTION}"));
    }
    let mut gaps = Vec::with_capacity(frames.len());
    for ((before, _), (after, _)) in frames.iter().zip(frames.iter().skip(1)) {
        if after <= before {
            return Err(format!(
                "camera stamps do not rise: {after} ns follows {before} ns"
            ));
        }
        gaps.push(after.abs_diff(*before));
    }
    // The median: a jittery pair of frames says nothing of the rate.
    gaps.sort_unstable();
    let tolerance = gaps.get(gaps.len() / 2).map_or(u64::MAX, |gap| gap / 2);
    let last = frames.len() - 1;
    let mut aligned = Vec::with_capacity(frames.len());
    for (index, (stamp, _)) in frames.iter().enumerate() {
        let near = actions
            .iter()
            .min_by_key(|(at, _)| at.abs_diff(*stamp))
            .filter(|(at, _)| at.abs_diff(*stamp) <= tolerance);
        match (near, aligned.last()) {
            (Some((_, values)), _) => aligned.push(*values),
            // After the last frame nothing need be done any more: some data sets record no action for it.
            (None, Some(before)) if index == last => aligned.push(*before),
            (None, _) => {
                return Err(format!(
                    "no message on {ACTION} within half a period of the frame at {stamp} ns"
                ));
            }
        }
    }
    Ok(aligned)
}

fn compressed(message: &BagMessage) -> Result<(i64, image::DynamicImage), String> {
    let picture: CompressedImage = message.decode().map_err(|error| error.to_string())?;
    let decoded = image::load_from_memory(&picture.data).map_err(|error| error.to_string())?;
    Ok((picture.header.stamp.to_nanos(), decoded))
}

fn frame(message: &BagMessage) -> Result<(i64, RgbImage), String> {
    if &*message.topic == COMPRESSED {
        let (stamp, picture) = compressed(message)?;
        return Ok((stamp, picture.into_rgb8()));
    }
    let picture: Image = message.decode().map_err(|error| error.to_string())?;
    if picture.encoding != "rgb8" || picture.step != picture.width * 3 {
        return Err(format!(
            "expected encoding rgb8 with step {}, found {} with step {}",
            picture.width * 3,
            picture.encoding,
            picture.step
        ));
    }
    let stamp = picture.header.stamp.to_nanos();
    let length = picture.data.len();
    RgbImage::from_raw(picture.width, picture.height, picture.data)
        .map(|rgb| (stamp, rgb))
        .ok_or_else(|| {
            format!(
                "{}x{} rgb8 does not fit {length} bytes",
                picture.height, picture.width
            )
        })
}

/// Class numbers may not be blended: nearest neighbour.
fn shrink_mask(mask: &GrayImage, (h, w): (usize, usize)) -> Vec<u8> {
    image::imageops::resize(mask, w as u32, h as u32, FilterType::Nearest).into_raw()
}
