//! Whether predictions obey actions (the paper, appendix C.1, A): the error of actions that a search recovers from the
//! latents that they led to, and how much worse a prediction gets under wrong actions.

mod recovered;
mod response;
mod summary;

use anyhow::Result;
use serde::{Deserialize, Serialize};

pub use recovered::{Recovered, Start};
pub use response::Response;
pub use summary::summarise;

use crate::{Settings, Subject, Windows};

/// What was found in one window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum WindowControl {
    /// Searches.
    Recovered(Recovered),
    /// Predictions under right and wrong actions.
    Response(Response),
}

/// The windows of both parts.
pub struct Control<'a> {
    subject: &'a Subject,
    settings: &'a Settings,
    /// With the steps that are searched in them.
    searched: Vec<(usize, Windows)>,
    told: Windows,
}

impl<'a> Control<'a> {
    /// Cuts the windows.
    ///
    /// # Errors
    /// If no episode is long enough.
    pub fn new(subject: &'a Subject, settings: &'a Settings) -> Result<Self> {
        let own = &settings.control;
        let windows =
            |horizon, most| Windows::new(&subject.latents, &subject.world.encoding, horizon, most);
        let searched = own.searches.iter();
        let searched = searched.map(|search| Ok((search.k, windows(search.k, search.windows)?)));
        Ok(Self {
            subject,
            settings,
            searched: searched.collect::<Result<_>>()?,
            told: windows(own.response_steps, own.response_windows)?,
        })
    }

    /// Names of the units: first the searches.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        let searched = self.searched.iter();
        let searched = searched
            .flat_map(|(k, own)| (0..own.len()).map(move |unit| format!("k={k} window {unit}")));
        let told = (0..self.told.len()).map(|unit| format!("window {unit}"));
        searched.chain(told).collect()
    }

    /// Measures one.
    ///
    /// # Errors
    /// If model and data do not fit.
    pub fn measure(&self, mut unit: usize) -> Result<WindowControl> {
        let (subject, settings) = (self.subject, self.settings);
        for (k, windows) in &self.searched {
            match unit.checked_sub(windows.len()) {
                None => {
                    let found = recovered::measure(subject, settings, windows, (unit, *k));
                    return found.map(WindowControl::Recovered);
                }
                Some(rest) => unit = rest,
            }
        }
        response::measure(subject, &self.told, unit).map(WindowControl::Response)
    }
}
