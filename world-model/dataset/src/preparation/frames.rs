use std::{
    fs::File,
    os::unix::fs::FileExt as _,
    path::PathBuf,
    sync::{Mutex, PoisonError},
};

use image::{
    GrayImage, RgbImage,
    imageops::{self, FilterType},
};
use rayon::prelude::*;
use wm_bag::BagReader;
use wm_camera::{
    camera_frame::CameraFrame,
    video::{Shown as VideoPicture, VideoStream},
};
use wm_model::{Fit, Framing, Part, PictureSize, Placement};
use wm_progress::Progress;

use super::Planned;
use crate::{
    DatasetError, Manifest, Size,
    camera_message::{CameraMessage, first_needed},
    cameras::MASK,
    cutting::Draft,
    recording::Broken,
    source_sizes::SizeCounts,
    store::NewFolder,
};

/// Decodes the frames of all episodes into the folder's files; gives the pictures of each source that cannot be decoded,
/// and the sizes of the others.
///
/// Episodes are decoded at the same time, each on one thread and by one picture at a time: a picture goes to its place in
/// the file as it comes, so that memory does not grow with the length of an episode.
pub(super) fn write(
    bags: &[Planned],
    readers: &[Option<BagReader>],
    manifest: &Manifest,
    folder: &NewFolder,
) -> Result<(Vec<Broken>, SizeCounts), DatasetError> {
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
        let Some(reader) = readers.get(bag.source).and_then(Option::as_ref) else {
            return Ok((bag.source, Broken::new()));
        };
        let broken = files.write_episode(reader, &bag.topics, draft, *first_frame)?;
        progress.inc(draft.actions.len() as u64);
        Ok((bag.source, broken))
    });
    let mut all = vec![Broken::new(); readers.len()];
    for (source, broken) in results.collect::<Result<Vec<_>, DatasetError>>()? {
        if let Some(all) = all.get_mut(source) {
            all.extend(broken);
        }
    }
    drop(progress);
    let sizes = files.sizes.into_inner();
    Ok((all, sizes.unwrap_or_else(PoisonError::into_inner)))
}

/// The files that pictures go to, with their paths.
struct Files {
    frames: (File, PathBuf),
    masks: Option<(File, PathBuf)>,
    view: Size,
    fit: Fit,
    views: usize,
    /// The sizes of the pictures so far.
    sizes: Mutex<SizeCounts>,
}

/// The pictures of a stream that an episode still waits for.
struct Awaited<'a> {
    topic: &'a str,
    /// Stamps of its frames, in order; a slow camera's picture may be in several.
    stamps: &'a [i64],
    is_there: Vec<bool>,
    /// The decoder, if the stream is a video.
    video: VideoStream,
}

impl Awaited<'_> {
    /// The frames of the episode that show a picture of this stamp, if it is not there yet.
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
    ) -> Result<Broken, DatasetError> {
        let mut awaited: Vec<Awaited<'_>> = topics
            .iter()
            .zip(&draft.stamps)
            .map(|(topic, stamps)| Awaited {
                topic,
                stamps,
                is_there: vec![false; stamps.len()],
                video: VideoStream::new(),
            })
            .collect();
        let mut broken = Broken::new();
        let (from_ns, to_ns) = draft.logged_ns;
        let begin_ns = topics
            .iter()
            .map(|topic| first_needed(reader, topic, from_ns))
            .min();
        let messages = reader
            .messages()
            .only_topics(topics)
            .starting_at(begin_ns.unwrap_or(from_ns));
        // Messages that cannot be read were counted at the first reading.
        for message in messages.flatten() {
            if message.log_time_ns > to_ns {
                break;
            }
            let of_topic = |awaited: &&mut Awaited<'_>| *awaited.topic == *message.topic;
            let Some((view, awaited)) = (0..).zip(&mut awaited).find(|(_, a)| of_topic(a)) else {
                continue;
            };
            let frame = match CameraMessage::of_bag(&message) {
                Ok(CameraMessage::Still(frame)) => frame,
                Ok(CameraMessage::Packet(packet)) => {
                    // A video of another format was refused at the first reading.
                    let pictures = awaited.video.feed(&packet).unwrap_or_default();
                    self.take(awaited, (first_frame, view), pictures)?;
                    continue;
                }
                Err(_) => continue,
            };
            let stamp_ns = frame.header().stamp.to_nanos();
            let frames = awaited.frames(stamp_ns);
            if frames.is_empty() {
                continue;
            }
            let Ok(shown) = self.decoded(&frame, view, awaited.topic == MASK) else {
                broken.insert((awaited.topic.to_owned(), stamp_ns));
                continue;
            };
            self.place(awaited, (first_frame, view), frames, &shown)?;
        }
        for (view, awaited) in awaited.iter_mut().enumerate() {
            let pictures = awaited.video.finish();
            self.take(awaited, (first_frame, view), pictures)?;
        }
        for stream in &awaited {
            let missing = stream.stamps.iter().zip(&stream.is_there);
            let missing = missing.filter(|(_, is_there)| !**is_there);
            broken.extend(missing.map(|(stamp_ns, _)| (stream.topic.to_owned(), *stamp_ns)));
        }
        Ok(broken)
    }

    /// Writes the pictures of a video that the episode waits for.
    fn take(
        &self,
        awaited: &mut Awaited<'_>,
        place: (usize, usize),
        pictures: Vec<VideoPicture>,
    ) -> Result<(), DatasetError> {
        for VideoPicture { header, picture } in pictures {
            let frames = awaited.frames(header.stamp.to_nanos());
            if frames.is_empty() {
                continue;
            }
            if let Ok(view) = self.placed(&picture, place.1) {
                self.place(awaited, place, frames, &Shown::View(view))?;
            }
        }
        Ok(())
    }

    /// Writes a picture to the frames of an episode that show it; the episode's first frame and the view say where.
    fn place(
        &self,
        awaited: &mut Awaited<'_>,
        (first_frame, view): (usize, usize),
        frames: std::ops::Range<usize>,
        shown: &Shown,
    ) -> Result<(), DatasetError> {
        for frame in frames {
            self.write(first_frame + frame, view, shown)?;
            if let Some(is_there) = awaited.is_there.get_mut(frame) {
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

    /// A picture of camera `view` at the size of a view.
    fn decoded(&self, frame: &CameraFrame, view: usize, is_mask: bool) -> Result<Shown, String> {
        if let (true, CameraFrame::Compressed(mask)) = (is_mask, frame) {
            let mask = image::load_from_memory(&mask.data).map_err(|error| error.to_string())?;
            return Ok(Shown::Mask(place(&mask.into_luma8(), self.view, self.fit)));
        }
        let picture = frame.decode().map_err(|error| error.to_string())?;
        Ok(Shown::View(self.placed(&picture, view)?))
    }

    /// Writes a picture to its place: a view to its columns of the frame.
    fn write(&self, frame: usize, view: usize, shown: &Shown) -> Result<(), DatasetError> {
        let Size { height, width } = self.view;
        let to = |(file, path): &(File, PathBuf), bytes: &[u8], at: usize| {
            let written = file.write_all_at(bytes, at as u64);
            written.map_err(DatasetError::io(path))
        };
        let row_bytes = width * 3;
        match (shown, &self.masks) {
            (Shown::Mask(mask), Some(masks)) => to(masks, mask.as_raw(), frame * height * width),
            (Shown::Mask(_), None) => Ok(()),
            (Shown::View(picture), _) if self.views == 1 => {
                to(&self.frames, picture.as_raw(), frame * height * row_bytes)
            }
            (Shown::View(picture), _) => {
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

enum Shown {
    View(RgbImage),
    Mask(GrayImage),
}

/// A mask as the picture beside it is placed: its bars are background.
fn place(mask: &GrayImage, size: Size, fit: Fit) -> GrayImage {
    let (width, height) = mask.dimensions();
    let to = PictureSize::from(size);
    let Some(Placement { source, target }) = fit.placement(PictureSize { width, height }, to)
    else {
        return GrayImage::new(to.width, to.height);
    };
    let cut = |Part {
                   x,
                   y,
                   width,
                   height,
               }: Part| imageops::crop_imm(mask, x, y, width, height);
    let scaled = shrink(
        &cut(source).to_image(),
        Size {
            height: target.height as usize,
            width: target.width as usize,
        },
    );
    let mut placed = GrayImage::new(to.width, to.height);
    imageops::replace(
        &mut placed,
        &scaled,
        i64::from(target.x),
        i64::from(target.y),
    );
    placed
}

/// Class numbers may not be blended: nearest neighbour.
pub(crate) fn shrink(mask: &GrayImage, size: Size) -> GrayImage {
    // A side is at most 4096.
    let (width, height) = (size.width as u32, size.height as u32);
    imageops::resize(mask, width, height, FilterType::Nearest)
}
