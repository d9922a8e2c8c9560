use wm_bag::BagReader;
use wm_msgs::{
    Message as _,
    sensor_msgs::{CompressedImage, Image},
};

/// The camera of a robot that has one.
pub(super) const CAMERA: &str = "/camera/image_raw";
/// The masks of its pictures, which the simulator writes.
pub(super) const MASK: &str = "/camera/mask/compressed";
const COMPRESSED: &str = "/compressed";

/// A camera's topic without its transport, so that bags are alike whose cameras differ in nothing else.
pub(super) fn base(topic: &str) -> &str {
    topic.strip_suffix(COMPRESSED).unwrap_or(topic)
}

/// The topics of the cameras that are asked for; of the usual one, or the only one, where none is.
///
/// Of a camera with both transports, which sends each frame twice, the compressed one is taken.
///
/// # Errors
/// Which one is missing, in words.
pub(super) fn cameras(reader: &BagReader, asked: &[String]) -> Result<Vec<String>, String> {
    if !asked.is_empty() {
        let missing = |topic: &String| {
            let others = names(reader);
            let others = if others.is_empty() {
                "no other camera".to_owned()
            } else {
                others.join(", ")
            };
            format!("no camera {topic}: expected frames on it; the bag has {others}")
        };
        let topics = asked
            .iter()
            .map(|topic| transport(reader, topic).ok_or_else(|| missing(topic)));
        return topics.collect();
    }
    if let Some(topic) = transport(reader, CAMERA) {
        return Ok(vec![topic]);
    }
    let found = names(reader);
    match found.as_slice() {
        [] => Err(format!(
            "no camera: expected frames on {CAMERA}{COMPRESSED} or {CAMERA}"
        )),
        [only] => Ok(transport(reader, only).into_iter().collect()),
        several => Err(format!(
            "several cameras, none of them {CAMERA}; choose with --camera: {}",
            several.join(", ")
        )),
    }
}

/// The topic of a camera with frames, by either transport.
fn transport(reader: &BagReader, camera: &str) -> Option<String> {
    // One that is given with its transport is meant so.
    let names = match camera.strip_suffix(COMPRESSED) {
        Some(base) => [camera.to_owned(), base.to_owned()],
        None => [format!("{camera}{COMPRESSED}"), camera.to_owned()],
    };
    names.into_iter().find(|name| has_frames(reader, name))
}

fn has_frames(reader: &BagReader, topic: &str) -> bool {
    reader.topic(topic).is_some_and(|topic| {
        let type_name = &*topic.type_name;
        topic.message_count > 0
            && (type_name == Image::ros_name() || type_name == CompressedImage::ros_name())
    })
}

/// The cameras that a bag has, but for pictures that were predicted.
fn names(reader: &BagReader) -> Vec<String> {
    let topics = reader.topics().iter().map(|topic| &*topic.name);
    let cameras = topics
        .filter(|name| !name.starts_with("/wm/") && *name != MASK && has_frames(reader, name));
    let mut names: Vec<String> = cameras.map(|name| base(name).to_owned()).collect();
    names.dedup();
    names
}
