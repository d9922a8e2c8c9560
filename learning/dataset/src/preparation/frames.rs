use std::{
    fs::File,
    hash::{DefaultHasher, Hasher as _},
    os::unix::fs::FileExt as _,
    path::PathBuf,
    sync::{Mutex, PoisonError},
};

use image::{DynamicImage, GrayImage, RgbImage};
use rayon::prelude::*;
use wm_audit::{Pictures, Stamps};
use wm_bag::BagReader;
use wm_camera::{
    camera_frame::CameraFrame,
    signature::Signature,
    video::{VideoPicture, VideoStream},
};
use wm_model::{Fit, Framing, PictureSize};
use wm_msgs::builtin_interfaces::Time;
use wm_program::progress::Progress;

use super::{BagPlan, bags::reader};
use crate::{
    DatasetError, Manifest, Size, StampSource,
    camera_message::{CameraMessage, first_needed},
    cameras::MASK,
    cutting::Draft,
    manifest::Source,
    mask,
    recording::BrokenPictures,
    source_sizes::SizeCounts,
    store::NewFolder,
};

/// The result of decoding.
pub(super) struct DecodedFrames {
    /// Undecodable pictures, by source.
    pub broken: Vec<BrokenPictures>,
    /// Sizes of all other pictures.
    pub sizes: SizeCounts,
    /// Mean change of each picture of the first camera since the previous one \[levels\], by episode, if known.
    pub changes: Vec<Vec<Option<f32>>>,
    /// Pictures of each source's video topics, for the audit. Other topics are compared by their bytes earlier.
    pub videos: Vec<Vec<Pictures>>,
}

/// The result of decoding an episode.
#[derive(Default)]
struct DecodedEpisode {
    broken: BrokenPictures,
    changes: Vec<Option<f32>>,
    videos: Vec<Pictures>,
}

/// Decodes the frames of all episodes into the folder's files.
///
/// Each episode takes one thread and one picture at a time. A picture is written at once, so memory does not grow with
/// the episode.
pub(super) fn write(
    bags: &[BagPlan],
    sources: &[Source],
    manifest: &Manifest,
    folder: &NewFolder,
) -> Result<DecodedFrames, DatasetError> {
    let total: usize = manifest.episodes.iter().map(|episode| episode.frames).sum();
    let progress = Progress::of("decoding", "frames", total as u64);
    let files = Files {
        frames: folder.create_file("frames")?,
        masks: match manifest.has_masks {
            true => Some(folder.create_file("masks")?),
            false => None,
        },
        view: manifest.size,
        fit: manifest.fit,
        views: manifest.cameras.len(),
        stamps: manifest.settings.stamps,
        sizes: Mutex::default(),
    };
    let mut jobs = Vec::new();
    let mut first_frame = 0;
    for bag in bags {
        for draft in &bag.episodes {
            jobs.push((bag, draft, first_frame));
            first_frame += draft.actions.len();
        }
    }
    let results = jobs.par_iter().map(|(bag, draft, first_frame)| {
        let Some(source) = sources.get(bag.source) else {
            return Ok((bag.source, DecodedEpisode::default()));
        };
        let reader = reader(source).map_err(|what| DatasetError::Episode {
            bag: source.bag.clone(),
            what,
        })?;
        let episode = files.write_episode(&reader, &bag.topics, draft, *first_frame)?;
        progress.inc(draft.actions.len() as u64);
        Ok((bag.source, episode))
    });
    let mut decoded = DecodedFrames {
        broken: vec![BrokenPictures::default(); sources.len()],
        sizes: SizeCounts::new(),
        changes: Vec::new(),
        videos: vec![Vec::new(); sources.len()],
    };
    for (source, episode) in results.collect::<Result<Vec<_>, DatasetError>>()? {
        if let Some(all) = decoded.broken.get_mut(source) {
            all.extend(episode.broken);
        }
        decoded.changes.push(episode.changes);
        if let Some(videos) = decoded.videos.get_mut(source) {
            for pictures in episode.videos {
                match videos.iter_mut().find(|all| all.topic == pictures.topic) {
                    Some(all) => all.append(pictures),
                    None => videos.push(pictures),
                }
            }
        }
    }
    drop(progress);
    let sizes = files.sizes.into_inner();
    decoded.sizes = sizes.unwrap_or_else(PoisonError::into_inner);
    Ok(decoded)
}

/// The output files, with their paths.
struct Files {
    frames: (File, PathBuf),
    masks: Option<(File, PathBuf)>,
    view: Size,
    fit: Fit,
    views: usize,
    stamps: StampSource,
    /// Sizes of the pictures so far.
    sizes: Mutex<SizeCounts>,
}

/// A stream whose pictures an episode still needs.
struct PendingStream<'a> {
    topic: &'a str,
    /// Stamps of its frames in order; a slow camera's picture may be in several.
    stamps: &'a [i64],
    is_there: Vec<bool>,
    /// Decoder, if the stream is a video.
    video: VideoStream,
    /// Pictures of a video, for the audit.
    shown: Pictures,
    changes: Changes,
}

/// Changes between the pictures of an episode.
struct Changes {
    /// Mean change since the previous picture \[levels\] by frame, if known.
    levels: Vec<Option<f32>>,
    /// The last picture, and its frame.
    last: Option<(usize, Signature)>,
}

impl Changes {
    fn new(frames: usize) -> Self {
        Self {
            levels: vec![None; frames],
            last: None,
        }
    }

    /// Adds the picture of a frame. Pictures arrive in recording order, which is almost that of the stamps.
    fn take(&mut self, frame: usize, signature: &Signature) {
        let before = self.last.as_ref().filter(|(last, _)| last + 1 == frame);
        let change = before.and_then(|(_, before)| before.change(signature));
        if let Some(place) = self.levels.get_mut(frame) {
            *place = change;
        }
        self.last = Some((frame, signature.clone()));
    }
}

impl PendingStream<'_> {
    /// The frames that need a picture of this stamp, unless already written.
    fn frames(&self, stamp_ns: i64) -> std::ops::Range<usize> {
        let first = self.stamps.partition_point(|other| *other < stamp_ns);
        let end = self.stamps.partition_point(|other| *other <= stamp_ns);
        match self.is_there.get(first) {
            Some(false) => first..end,
            _ => first..first,
        }
    }
}

impl Files {
    fn write_episode(
        &self,
        reader: &BagReader,
        topics: &[String],
        draft: &Draft,
        first_frame: usize,
    ) -> Result<DecodedEpisode, DatasetError> {
        let mut pending: Vec<PendingStream<'_>> = topics
            .iter()
            .zip(&draft.stamps)
            .map(|(topic, stamps)| PendingStream {
                topic,
                stamps,
                is_there: vec![false; stamps.len()],
                video: VideoStream::new(),
                shown: Pictures::new(topic),
                changes: Changes::new(stamps.len()),
            })
            .collect();
        let mut broken = BrokenPictures::default();
        let (from_ns, to_ns) = draft.logged_ns;
        let begin_ns = topics
            .iter()
            .map(|topic| first_needed(reader, topic, from_ns))
            .min();
        let messages = reader
            .messages()
            .only_topics(topics)
            .starting_at(begin_ns.unwrap_or(from_ns));
        // The first pass counted unreadable messages.
        for message in messages.flatten() {
            if message.log_time_ns > to_ns {
                break;
            }
            let of_topic = |pending: &&mut PendingStream<'_>| *pending.topic == *message.topic;
            let Some((view, pending)) = (0..).zip(&mut pending).find(|(_, a)| of_topic(a)) else {
                continue;
            };
            let frame = match CameraMessage::of_bag(&message) {
                Ok(CameraMessage::Still(frame)) => frame,
                Ok(CameraMessage::Packet(mut packet)) => {
                    let header_ns = packet.header.stamp.to_nanos();
                    let stamp_ns = self.stamps.of(Stamps::of_bag(&message, header_ns));
                    packet.header.stamp = Time::from_nanos(stamp_ns);
                    // The first pass rejected videos of other formats.
                    let pictures = pending.video.feed(&packet).unwrap_or_default();
                    self.take(pending, (first_frame, view), pictures)?;
                    continue;
                }
                Err(_) => continue,
            };
            let header_ns = frame.header().stamp.to_nanos();
            let stamp_ns = self.stamps.of(Stamps::of_bag(&message, header_ns));
            let frames = pending.frames(stamp_ns);
            if frames.is_empty() {
                continue;
            }
            let shown = match self.decoded(&frame, view, pending.topic == MASK) {
                Ok(shown) => shown,
                Err(reason) => {
                    broken.insert(pending.topic, stamp_ns, || reason);
                    continue;
                }
            };
            self.place(pending, (first_frame, view), frames, &shown)?;
        }
        for (view, pending) in pending.iter_mut().enumerate() {
            let pictures = pending.video.finish();
            self.take(pending, (first_frame, view), pictures)?;
        }
        for stream in &pending {
            let missing = stream.stamps.iter().zip(&stream.is_there);
            let missing = missing.filter(|(_, is_there)| !**is_there);
            for (stamp_ns, _) in missing {
                broken.insert(stream.topic, *stamp_ns, || {
                    "the message has no picture".to_owned()
                });
            }
        }
        let mut episode = DecodedEpisode {
            broken,
            ..DecodedEpisode::default()
        };
        for (view, stream) in pending.into_iter().enumerate() {
            if view == 0 {
                episode.changes = stream.changes.levels;
            }
            if stream.shown.count() > 0 {
                episode.videos.push(stream.shown);
            }
        }
        Ok(episode)
    }

    /// Writes the pictures of a video that the episode needs.
    fn take(
        &self,
        pending: &mut PendingStream<'_>,
        place: (usize, usize),
        pictures: Vec<VideoPicture>,
    ) -> Result<(), DatasetError> {
        for VideoPicture {
            header, picture, ..
        } in pictures
        {
            let stamp_ns = header.stamp.to_nanos();
            let span = pending.stamps.first().zip(pending.stamps.last());
            if !span.is_some_and(|(first, last)| (*first..=*last).contains(&stamp_ns)) {
                continue;
            }
            let signature = Signature::of(&picture);
            let size = Some(picture.dimensions());
            let bytes = fingerprint(&picture);
            let of_audit = Some(signature.clone());
            pending.shown.push(stamp_ns, bytes, size, of_audit);
            let frames = pending.frames(stamp_ns);
            if frames.is_empty() {
                continue;
            }
            if let Ok(view) = self.placed(&picture, place.1) {
                let shown = PlacedPicture::View(view, signature);
                self.place(pending, place, frames, &shown)?;
            }
        }
        Ok(())
    }

    /// Writes a picture to its frames, from the episode's first frame on, in column `view`.
    fn place(
        &self,
        pending: &mut PendingStream<'_>,
        (first_frame, view): (usize, usize),
        frames: std::ops::Range<usize>,
        shown: &PlacedPicture,
    ) -> Result<(), DatasetError> {
        if let (0, PlacedPicture::View(_, signature)) = (view, shown) {
            pending.changes.take(frames.start, signature);
        }
        for frame in frames {
            self.write(first_frame + frame, view, shown)?;
            if let Some(is_there) = pending.is_there.get_mut(frame) {
                *is_there = true;
            }
        }
        Ok(())
    }

    /// A picture of camera `view` at the size of a view.
    fn placed(&self, picture: &RgbImage, view: usize) -> Result<RgbImage, String> {
        let Size { height, width } = self.view;
        let placed = Framing::new((height, width), self.fit).apply(picture);
        let placed = placed.map_err(|error| error.to_string())?;
        let mut sizes = self.sizes.lock().unwrap_or_else(PoisonError::into_inner);
        *sizes.entry((view, PictureSize::of(picture))).or_default() += 1;
        Ok(placed)
    }

    /// A message's picture at the size of a view.
    fn decoded(
        &self,
        frame: &CameraFrame,
        view: usize,
        is_mask: bool,
    ) -> Result<PlacedPicture, String> {
        let picture = frame.decode().map_err(|error| error.to_string())?;
        if is_mask {
            // Grey values stay: luma weights sum to one.
            let mask = DynamicImage::from(picture).into_luma8();
            return Ok(PlacedPicture::Mask(mask::place(&mask, self.view, self.fit)));
        }
        Ok(PlacedPicture::View(
            self.placed(&picture, view)?,
            Signature::of(&picture),
        ))
    }

    /// Writes a picture to its columns of a frame.
    fn write(&self, frame: usize, view: usize, shown: &PlacedPicture) -> Result<(), DatasetError> {
        let Size { height, width } = self.view;
        let to = |(file, path): &(File, PathBuf), bytes: &[u8], at: usize| {
            let written = file.write_all_at(bytes, at as u64);
            written.map_err(DatasetError::io(path))
        };
        let row_bytes = width * 3;
        match (shown, &self.masks) {
            (PlacedPicture::Mask(mask), Some(masks)) => {
                to(masks, mask.as_raw(), frame * height * width)
            }
            (PlacedPicture::Mask(_), None) => Ok(()),
            (PlacedPicture::View(picture, _), _) if self.views == 1 => {
                to(&self.frames, picture.as_raw(), frame * height * row_bytes)
            }
            (PlacedPicture::View(picture, _), _) => {
                let rows = picture.as_raw().chunks_exact(row_bytes).enumerate();
                for (row, bytes) in rows {
                    let row = frame * height + row;
                    let at = (row * self.views + view) * row_bytes;
                    to(&self.frames, bytes, at)?;
                }
                Ok(())
            }
        }
    }
}

/// Equal for pictures with equal pixels.
fn fingerprint(picture: &RgbImage) -> u64 {
    let mut hasher = DefaultHasher::new();
    hasher.write(picture.as_raw());
    hasher.finish()
}

enum PlacedPicture {
    /// At the size of a view, with the signature of the whole picture.
    View(RgbImage, Signature),
    Mask(GrayImage),
}
