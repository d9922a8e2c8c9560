//! Whether predictions obey actions (the paper, appendix C.1, A): the error of actions recovered by search from their
//! latents, and the loss of predictions under wrong actions.

mod recovered;
mod response;
mod searched;
mod summary;

use anyhow::Result;
use serde::{Deserialize, Serialize};

pub use recovered::{RecoveredActions, Start};
pub use response::Response;
use searched::Searched;
pub use searched::SearchedDimensions;
pub use summary::summarise;

use crate::{Settings, Subject, Windows};

/// Result of one window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum WindowControl {
    /// Searches.
    Recovered(RecoveredActions),
    /// Predictions under right and wrong actions.
    Response(Response),
}

/// The windows of both parts.
pub struct Control<'a> {
    subject: &'a Subject,
    settings: &'a Settings,
    /// With the number of steps searched in them.
    searches: Vec<(usize, Windows)>,
    searched: Searched,
    responses: Windows,
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
        let searches = own.searches.iter();
        let searches = searches.map(|search| Ok((search.k, windows(search.k, search.windows)?)));
        let searches: Vec<(usize, Windows)> = searches.collect::<Result<_>>()?;
        let responses = windows(own.response_steps, own.response_windows)?;
        let searched = match searches.is_empty() {
            true => Searched::nothing(),
            false => Searched::of(subject, settings, &responses)?,
        };
        Ok(Self {
            subject,
            settings,
            searches,
            searched,
            responses,
        })
    }

    /// Names of the units; searches come first.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        let searched = self.searches.iter();
        let searched = searched
            .flat_map(|(k, own)| (0..own.len()).map(move |unit| format!("k={k} window {unit}")));
        let responses = (0..self.responses.len()).map(|unit| format!("window {unit}"));
        searched.chain(responses).collect()
    }

    /// Measures one unit.
    ///
    /// # Errors
    /// If model and data do not fit.
    pub fn measure(&self, mut unit: usize) -> Result<WindowControl> {
        let (subject, settings) = (self.subject, self.settings);
        for (k, windows) in &self.searches {
            match unit.checked_sub(windows.len()) {
                None => {
                    let found = recovered::measure(
                        subject,
                        (settings, &self.searched),
                        windows,
                        (unit, *k),
                    );
                    return found.map(WindowControl::Recovered);
                }
                Some(rest) => unit = rest,
            }
        }
        response::measure(subject, &self.responses, unit).map(WindowControl::Response)
    }
}
