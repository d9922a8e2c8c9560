//! The videos of a data set, and the places of episodes in them.

use std::{
    collections::{BTreeMap, HashMap},
    path::{Path, PathBuf},
};

use crate::video::Video;

use super::placement::{Member, Placement, Times, place};
use crate::lerobot::{
    LeRobotError,
    dataset::{Clip, Dataset},
};

/// The last video of each camera: consecutive episodes share it.
pub(super) struct Videos {
    members: BTreeMap<PathBuf, Vec<Member>>,
    open: HashMap<String, OpenVideo>,
}

struct OpenVideo {
    video: Video,
    placement: Placement,
}

impl Videos {
    pub fn of(dataset: &Dataset) -> Self {
        let mut members: BTreeMap<PathBuf, Vec<Member>> = BTreeMap::new();
        for entry in &dataset.episodes {
            for clip in entry.videos.values() {
                let member = Member {
                    index: entry.index,
                    length: usize::try_from(entry.length).unwrap_or(usize::MAX),
                    from_s: clip.from_s,
                };
                members.entry(clip.file.clone()).or_default().push(member);
            }
        }
        Self {
            members,
            open: HashMap::new(),
        }
    }

    /// The frames of an episode as JPEG, and a remark.
    ///
    /// # Errors
    /// The video cannot be read, or the frames of the episode are uncertain; both name the file and the feature.
    pub fn frames(
        &mut self,
        dataset: &Dataset,
        key: &str,
        clip: &Clip,
        episode: i64,
        quality: u8,
    ) -> Result<(Vec<Vec<u8>>, Option<&'static str>), LeRobotError> {
        let corrupt =
            |reason: String| LeRobotError::corrupt(&clip.file, format!("{key}: {reason}"));
        let is_open = |open: &OpenVideo| open.video.file() == clip.file;
        if !self.open.get(key).is_some_and(is_open) {
            // Close the previous file first: both may be large.
            self.open.remove(key);
            let opened = self.open_video(&clip.file, dataset.info.fps)?;
            self.open.insert(key.to_owned(), opened);
        }
        let open = self.open.get(key);
        let open = open.ok_or_else(|| corrupt("it is not open".to_owned()))?;
        let placed = open.placement.get(&episode);
        let placed = placed.ok_or_else(|| corrupt(format!("it has no episode {episode}")))?;
        let frames = placed.as_ref().map_err(|reason| corrupt(reason.clone()))?;
        Ok((
            open.video.jpegs(frames.range.clone(), quality)?,
            frames.note,
        ))
    }

    fn open_video(&self, file: &Path, fps: f64) -> Result<OpenVideo, LeRobotError> {
        let video = Video::open(file)?;
        let times: Vec<f64> = (0..video.frame_count())
            .filter_map(|frame| video.time_s(frame))
            .collect();
        let members = self.members.get(file).map_or(&[][..], Vec::as_slice);
        let placement = place(&Times(&times), fps, members);
        Ok(OpenVideo { video, placement })
    }
}
