//! Bags of what passes.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel},
    thread::JoinHandle,
};

use anyhow::{Context as _, Result};
use image::{RgbImage, imageops::FilterType};
use tokio::sync::mpsc::UnboundedSender;
use wm_bag::{BagWriter, Compression, QosProfile, WriterOptions, recover};
use wm_camera::{camera_frame::CameraFrame, image_message::encode_jpeg};
use wm_msgs::{sensor_msgs::CompressedImage, wm_msgs::Action};

/// Topics of the bags, as the trainings expect them.
const PICTURES: &str = "/camera/image_raw/compressed";
const ACTIONS: &str = "/wm/action";
/// The note with the action space.
const ACTION_SPACE: &str = "action_space";
/// Items that wait for the disk; about ten seconds of a camera of 10 Hz.
const WAITING: usize = 256;
/// By how much messages of different topics may overtake each other \[ns\].
const DISORDER_NS: i64 = 1_000_000_000;
/// Prefix of the bags' names.
const PREFIX: &str = "bag-";

/// Settings of the recording.
#[derive(Clone, Debug)]
pub(super) struct RecordingSettings {
    /// Folder of the bags.
    pub folder: PathBuf,
    /// Duration of a bag \[ns\].
    pub bag_ns: u64,
    /// Longest side of a picture; larger ones are made smaller.
    pub picture_side: u32,
    /// JPEG quality.
    pub quality: u8,
    /// The action space, as JSON.
    pub action_space: String,
}

/// A message to record, with the time of its receipt \[ns\].
pub(super) enum Item {
    Picture(Box<CameraFrame>, u64),
    Action(Action, u64),
}

impl Item {
    /// The time of its receipt and its stamp \[ns\].
    fn times(&self) -> (u64, i64) {
        match self {
            Self::Picture(frame, at_ns) => (*at_ns, frame.header().stamp.to_nanos()),
            Self::Action(action, at_ns) => (*at_ns, action.header.stamp.to_nanos()),
        }
    }
}

/// A finished bag, or why pictures are missing.
#[derive(Debug)]
pub(super) enum Recorded {
    /// A bag of this many seconds.
    Bag { seconds: f64 },
    /// A picture that cannot be decoded.
    BadPicture(String),
    /// The recording has ended.
    Failed(anyhow::Error),
}

/// Records on a thread of its own, since the disk may be slow.
pub(super) struct Recording {
    items: Option<SyncSender<Item>>,
    thread: Option<JoinHandle<()>>,
}

impl Recording {
    /// Records into `settings.folder`; results go to `results`.
    ///
    /// # Errors
    /// The folder cannot be made, or the thread cannot be started.
    pub(super) fn begin(
        settings: RecordingSettings,
        results: UnboundedSender<Recorded>,
    ) -> Result<Self> {
        let folder = &settings.folder;
        fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
        let (sender, items) = sync_channel(WAITING);
        let record = move || {
            if let Err(error) = record(&settings, &items, &results) {
                // Without a receiver, the node has ended.
                results.send(Recorded::Failed(error)).ok();
            }
        };
        let thread = std::thread::Builder::new().name("recording".to_owned());
        Ok(Self {
            items: Some(sender),
            thread: Some(thread.spawn(record)?),
        })
    }

    /// Records an item; returns whether there was room for it.
    pub(super) fn record(&self, item: Item) -> bool {
        let Some(items) = &self.items else {
            return false;
        };
        !matches!(items.try_send(item), Err(TrySendError::Full(_)))
    }
}

impl Drop for Recording {
    fn drop(&mut self) {
        // The thread ends, with its bag, when no more items can come.
        drop(self.items.take());
        if let Some(thread) = self.thread.take() {
            thread.join().ok();
        }
    }
}

/// Makes whole bags of those that a killed process left, and returns the duration of all bags \[s\].
pub(super) fn recover_all(folder: &Path) -> Result<f64> {
    let mut seconds = 0.0;
    for bag in bags(folder)? {
        if !bag.path.join("metadata.yaml").is_file() {
            let whole = bag.path.with_extension("recovered");
            match recover(&bag.path, &whole) {
                Ok(_) => {
                    let part = bag.path.with_extension("part");
                    fs::rename(&bag.path, &part)?;
                    fs::rename(&whole, &bag.path)?;
                    fs::remove_dir_all(&part)?;
                }
                Err(error) => {
                    tracing::warn!("{}: {error}; it is not used", bag.path.display());
                    continue;
                }
            }
        }
        seconds += duration_s(&bag.path)?;
    }
    Ok(seconds)
}

/// A bag in the folder.
pub(super) struct Bag {
    pub path: PathBuf,
    /// \[bytes\]
    pub size: u64,
}

/// The bags in the folder, oldest first.
pub(super) fn bags(folder: &Path) -> Result<Vec<Bag>> {
    let mut bags = Vec::new();
    let entries = fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    for entry in entries {
        let entry = entry?;
        let name = entry.file_name();
        let is_bag = name.to_str().is_some_and(is_own_name);
        if is_bag && entry.file_type()?.is_dir() {
            let files = fs::read_dir(entry.path())?;
            let size = files
                .map(|file| Ok(file?.metadata()?.len()))
                .sum::<std::io::Result<u64>>()?;
            bags.push(Bag {
                path: entry.path(),
                size,
            });
        }
    }
    bags.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(bags)
}

/// Whether a bag may be the learner's. A user's bag in the folder is not touched.
fn is_own_name(name: &str) -> bool {
    let digits = name.strip_prefix(PREFIX);
    digits.is_some_and(|digits| digits.len() == 20 && digits.bytes().all(|b| b.is_ascii_digit()))
}

/// The duration of a bag \[s\].
pub(super) fn duration_s(bag: &Path) -> Result<f64> {
    let reader = wm_bag::BagReader::open(bag).with_context(|| bag.display().to_string())?;
    Ok(reader.summary().duration_ns() as f64 / 1e9)
}

/// The bag that is written.
struct OpenBag {
    writer: BagWriter,
    /// By the time of receipt \[ns\].
    begin_ns: u64,
    /// The newest stamp \[ns\].
    newest_ns: i64,
}

impl OpenBag {
    /// Whether a message of these times belongs into the next bag: this one is long enough, or time went back, as when a
    /// recording or a simulation begins again.
    fn is_over(&self, at_ns: u64, stamp_ns: i64, bag_ns: u64) -> bool {
        at_ns.saturating_sub(self.begin_ns) >= bag_ns
            || stamp_ns.saturating_add(DISORDER_NS) < self.newest_ns
    }
}

fn record(
    settings: &RecordingSettings,
    items: &Receiver<Item>,
    results: &UnboundedSender<Recorded>,
) -> Result<()> {
    let mut open: Option<OpenBag> = None;
    let mut last_picture_ns = None;
    for item in items {
        let (at_ns, stamp_ns) = item.times();
        if let Some(bag) = open.take_if(|bag| bag.is_over(at_ns, stamp_ns, settings.bag_ns)) {
            finish(bag, results)?;
        }
        let message = match item {
            Item::Action(action, _) => Message::Action(action),
            Item::Picture(frame, _) => {
                // Of two transports, the later one repeats the frame.
                if last_picture_ns.replace(stamp_ns) == Some(stamp_ns) {
                    continue;
                }
                match small(&frame, settings) {
                    Ok(picture) => Message::Picture(picture),
                    Err(error) => {
                        results
                            .send(Recorded::BadPicture(format!("{error:#}")))
                            .ok();
                        continue;
                    }
                }
            }
        };
        let bag = match &mut open {
            Some(bag) => bag,
            None => open.insert(begin(settings, at_ns)?),
        };
        bag.newest_ns = bag.newest_ns.max(stamp_ns);
        match message {
            Message::Picture(picture) => bag.writer.write(PICTURES, &picture, at_ns)?,
            Message::Action(action) => bag.writer.write(ACTIONS, &action, at_ns)?,
        }
    }
    match open {
        Some(bag) => finish(bag, results),
        None => Ok(()),
    }
}

enum Message {
    Picture(CompressedImage),
    Action(Action),
}

fn begin(settings: &RecordingSettings, at_ns: u64) -> Result<OpenBag> {
    // Twenty digits hold any time, so that names sort by age.
    let path = settings.folder.join(format!("{PREFIX}{at_ns:020}"));
    let options = WriterOptions {
        // The pictures are compressed already.
        compression: Compression::None,
        ..WriterOptions::default()
    };
    let mut writer = BagWriter::create(&path, options)?;
    writer.note(ACTION_SPACE, settings.action_space.as_str());
    writer.add_topic::<CompressedImage>(PICTURES, QosProfile::sensor_data())?;
    writer.add_topic::<Action>(ACTIONS, QosProfile::reliable())?;
    Ok(OpenBag {
        writer,
        begin_ns: at_ns,
        newest_ns: i64::MIN,
    })
}

fn finish(bag: OpenBag, results: &UnboundedSender<Recorded>) -> Result<()> {
    let summary = bag.writer.finish()?;
    let seconds = summary.duration_ns() as f64 / 1e9;
    results.send(Recorded::Bag { seconds }).ok();
    Ok(())
}

/// A picture of at most the settings' size, as JPEG.
fn small(frame: &CameraFrame, settings: &RecordingSettings) -> Result<CompressedImage> {
    let picture = frame.decode()?;
    let side = picture.width().max(picture.height());
    let picture = match side > settings.picture_side {
        true => shrunk(&picture, f64::from(settings.picture_side) / f64::from(side)),
        false => picture,
    };
    Ok(encode_jpeg(
        &picture,
        frame.header().clone(),
        settings.quality,
    )?)
}

fn shrunk(picture: &RgbImage, scale: f64) -> RgbImage {
    let scaled = |length: u32| ((f64::from(length) * scale).round() as u32).max(1);
    let (width, height) = (scaled(picture.width()), scaled(picture.height()));
    image::imageops::resize(picture, width, height, FilterType::Triangle)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;
    use tokio::sync::mpsc::unbounded_channel;
    use wm_camera::image_message::encode_image;
    use wm_msgs::{builtin_interfaces::Time, std_msgs::Header};

    const SECOND: u64 = 1_000_000_000;

    fn settings(folder: &Path) -> RecordingSettings {
        RecordingSettings {
            folder: folder.to_owned(),
            bag_ns: 2 * SECOND,
            picture_side: 64,
            quality: 95,
            action_space: "{}".to_owned(),
        }
    }

    fn header(at_ns: u64) -> Header {
        Header {
            stamp: Time::from_nanos(at_ns as i64),
            ..Header::default()
        }
    }

    fn picture(at_ns: u64) -> Item {
        let picture = RgbImage::from_pixel(128, 96, Rgb([10, 200, 30]));
        let frame = CameraFrame::Raw(encode_image(&picture, header(at_ns)));
        Item::Picture(Box::new(frame), at_ns)
    }

    fn action(at_ns: u64) -> Item {
        let action = Action {
            header: header(at_ns),
            values: vec![0.1; 7],
        };
        Item::Action(action, at_ns)
    }

    #[test]
    fn bags_of_some_seconds_hold_small_pictures_and_actions() {
        let folder = tempfile::tempdir().unwrap();
        let (sender, mut results) = unbounded_channel();
        let recording = Recording::begin(settings(folder.path()), sender).unwrap();
        for tenth in 0..50 {
            let at_ns = SECOND + tenth * SECOND / 10;
            assert!(recording.record(picture(at_ns)));
            assert!(recording.record(picture(at_ns)), "the other transport");
            assert!(recording.record(action(at_ns)));
        }
        drop(recording);
        let mut seconds = Vec::new();
        while let Some(Recorded::Bag { seconds: own }) = results.blocking_recv() {
            seconds.push(own);
        }
        assert_eq!(seconds, [1.9, 1.9, 0.9]);
        let all = bags(folder.path()).unwrap();
        assert_eq!(all.len(), 3);
        let reader = wm_bag::BagReader::open(&all[0].path).unwrap();
        let summary = reader.summary();
        let counts: Vec<u64> = summary
            .topics
            .iter()
            .map(|topic| topic.message_count)
            .collect();
        assert_eq!(counts, [20, 20]);
        assert_eq!(reader.note(ACTION_SPACE), Some("{}"));
        assert_eq!(recover_all(folder.path()).unwrap(), 4.7);
    }

    #[test]
    fn bag_of_a_killed_process_is_recovered() {
        let folder = tempfile::tempdir().unwrap();
        let settings = settings(folder.path());
        let mut bag = begin(&settings, SECOND).unwrap();
        let Item::Action(message, _) = action(SECOND) else {
            panic!();
        };
        bag.writer.write(ACTIONS, &message, SECOND).unwrap();
        bag.writer.write(ACTIONS, &message, 2 * SECOND).unwrap();
        bag.writer.flush().unwrap();
        std::mem::forget(bag);
        // a user's bag in the same folder
        fs::create_dir(folder.path().join("bag-morning")).unwrap();
        assert_eq!(recover_all(folder.path()).unwrap(), 1.0);
        let all = bags(folder.path()).unwrap();
        assert!(all.len() == 1 && all[0].path.join("metadata.yaml").is_file());
    }

    #[test]
    fn time_that_goes_back_begins_a_new_bag() {
        let folder = tempfile::tempdir().unwrap();
        let (sender, _results) = unbounded_channel();
        let recording = Recording::begin(settings(folder.path()), sender).unwrap();
        let stamps = [5 * SECOND, 6 * SECOND, 11 * SECOND / 2, 3 * SECOND];
        for (at_ns, stamp_ns) in (SECOND..).zip(stamps) {
            let Item::Picture(frame, _) = picture(stamp_ns) else {
                panic!();
            };
            recording.record(Item::Picture(frame, at_ns));
        }
        drop(recording);
        assert_eq!(bags(folder.path()).unwrap().len(), 2);
    }
}
