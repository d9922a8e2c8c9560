use super::Episode;

/// Episodes of several files, with the location of their frames.
#[derive(Clone, Debug, Default)]
pub(crate) struct Layout {
    episodes: Vec<Episode>,
    /// By episode.
    places: Vec<Place>,
}

/// Location of an episode's frames.
#[derive(Clone, Copy, Debug)]
struct Place {
    file: usize,
    first: usize,
}

impl Layout {
    /// Adds an episode with consecutive frames in file `file`, from `episode.first_frame` on.
    pub fn push(&mut self, file: usize, episode: &Episode) {
        self.places.push(Place {
            file,
            first: episode.first_frame,
        });
        let first_frame = self.frame_count();
        self.episodes.push(Episode {
            first_frame,
            ..episode.clone()
        });
    }

    /// Episodes by frame.
    pub fn episodes(&self) -> &[Episode] {
        &self.episodes
    }

    /// Frames of all episodes.
    pub fn frame_count(&self) -> usize {
        let last = self.episodes.last();
        last.map_or(0, |last| last.first_frame + last.frame_count)
    }

    /// File and index of frame `index`; `None` past the end.
    pub fn locate(&self, index: usize) -> Option<(usize, usize)> {
        let after = self.episodes.partition_point(|e| e.first_frame <= index);
        let at = after.checked_sub(1)?;
        let (episode, place) = self.episodes.get(at).zip(self.places.get(at))?;
        let within = index - episode.first_frame;
        (within < episode.frame_count).then_some((place.file, place.first + within))
    }
}
