use wm_bag::{BagReader, TopicInfo};
use wm_camera::transport::{COMPRESSED, Transport, VIDEO, base};

/// Topic of a single camera.
pub(super) const CAMERA: &str = "/camera/image_raw";
/// Mask topic of the simulator.
pub(super) const MASK: &str = "/camera/mask/compressed";
/// The requested camera topics; by default the usual one, or the only one.
///
/// A camera with several transports publishes each frame several times: compressed is preferred, then raw, then video.
///
/// # Errors
/// A description of the missing camera.
pub(super) fn cameras(reader: &BagReader, requested: &[String]) -> Result<Vec<String>, String> {
    if !requested.is_empty() {
        let missing = |topic: &String| {
            let others = names(reader);
            let others = if others.is_empty() {
                "no other camera".to_owned()
            } else {
                others.join(", ")
            };
            let advice = advice(reader);
            format!("no camera {topic}: expected frames on it; the bag has {others}{advice}")
        };
        let topics = requested
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
            "no camera: expected frames on {CAMERA}{COMPRESSED} or {CAMERA}{}",
            advice(reader)
        )),
        [only] => Ok(transport(reader, only).into_iter().collect()),
        several => Err(format!(
            "several cameras, none of them {CAMERA}; choose with --camera: {}",
            several.join(", ")
        )),
    }
}

/// The topic of a camera with frames, by its transports.
fn transport(reader: &BagReader, camera: &str) -> Option<String> {
    // A name with transport is used as it is.
    let base = base(camera);
    let compressed = format!("{base}{COMPRESSED}");
    let videos = VIDEO.map(|transport| format!("{base}{transport}"));
    let names = match camera == base {
        true => [compressed, camera.to_owned()],
        false => [camera.to_owned(), base.to_owned()],
    };
    let mut names = names.into_iter().chain(videos);
    names.find(|name| has_frames(reader, name))
}

fn has_frames(reader: &BagReader, topic: &str) -> bool {
    reader.topic(topic).is_some_and(is_camera)
}

fn is_camera(topic: &TopicInfo) -> bool {
    let transport = Transport::of(&topic.name, &topic.type_name);
    let is_read = |transport: Transport| transport.is_read() || transport == Transport::Video;
    topic.message_count > 0 && transport.is_some_and(is_read)
}

/// Advice on topics with unreadable pictures.
fn advice(reader: &BagReader) -> String {
    let unread = reader.topics().iter().filter_map(|topic| {
        let transport = Transport::of(&topic.name, &topic.type_name)?;
        match is_camera(topic) {
            true => None,
            false => transport.advice(&topic.name),
        }
    });
    unread.map(|advice| format!("; {advice}")).collect()
}

/// Cameras of a bag, without predicted pictures.
fn names(reader: &BagReader) -> Vec<String> {
    let topics = reader.topics().iter().map(|topic| &*topic.name);
    let cameras = topics
        .filter(|name| !name.starts_with("/wm/") && *name != MASK && has_frames(reader, name));
    let mut names: Vec<String> = cameras.map(|name| base(name).to_owned()).collect();
    names.dedup();
    names
}
