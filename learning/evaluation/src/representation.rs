//! Whether real and predicted latents encode actions and success (the paper, appendix C.3): Pearson's r of an inverse
//! dynamics model, and the accuracy of a success probe.

mod features;
mod recovery;
mod success;
mod summary;

use anyhow::Result;
use serde::{Deserialize, Serialize};

pub use features::{EpisodeFeatures, IdmFeatures};
pub use recovery::{IdmActions, InferredActions};
pub use success::{Answers, EpisodeVerdicts};
pub use summary::summarise;

use crate::{Settings, Subject};

/// Result of one unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Representation {
    /// The actions of a window.
    Told(InferredActions),
    /// The success of an episode.
    Judged(EpisodeVerdicts),
    /// The features of an episode's actions.
    Features(EpisodeFeatures),
}

/// The units of all parts.
pub struct Representations<'a> {
    subject: &'a Subject,
    settings: &'a Settings,
    recovery: Option<crate::Windows>,
    judged: Vec<usize>,
    followed: Vec<usize>,
}

impl<'a> Representations<'a> {
    /// Cuts the windows and chooses the episodes.
    ///
    /// # Errors
    /// If no episode is long enough.
    pub fn new(subject: &'a Subject, settings: &'a Settings) -> Result<Self> {
        Ok(Self {
            subject,
            settings,
            recovery: recovery::windows(subject, settings)?,
            judged: success::units(subject, settings),
            followed: features::units(subject, settings),
        })
    }

    /// Names of the units: windows, judged episodes, then those whose features are followed.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        let windows = (0..self.windows()).map(|unit| format!("window {unit}"));
        let episodes = self.subject.dataset.episodes();
        let judged = self
            .judged
            .iter()
            .filter_map(|episode| episodes.get(*episode));
        let followed = self
            .followed
            .iter()
            .filter_map(|episode| episodes.get(*episode));
        windows
            .chain(judged.map(|e| e.name.clone()))
            .chain(followed.map(|e| format!("features of {}", e.name)))
            .collect()
    }

    fn windows(&self) -> usize {
        self.recovery.as_ref().map_or(0, crate::Windows::len)
    }

    /// Measures one unit.
    ///
    /// # Errors
    /// If model and data do not fit.
    pub fn measure(&self, unit: usize) -> Result<Representation> {
        let seed = self.settings.seed.wrapping_add(unit as u64);
        if let (Some(windows), true) = (&self.recovery, unit < self.windows()) {
            return recovery::measure(self.subject, windows, unit).map(Representation::Told);
        }
        let unit = unit - self.windows();
        if let Some(episode) = self.judged.get(unit) {
            return success::measure(self.subject, *episode, seed).map(Representation::Judged);
        }
        let episode = self.followed.get(unit - self.judged.len());
        let episode = anyhow::Context::context(episode, "no such unit")?;
        features::measure(self.subject, *episode, seed).map(Representation::Features)
    }
}
