//! Several judges of one set of rollouts.

use std::{borrow::Borrow, collections::BTreeSet, path::Path, sync::Arc};

use serde::Deserialize;

use crate::judges::{
    Error, Result,
    endpoint::{Clock, EndpointSettings, SystemClock},
    frames::FrameChoice,
    judge::Judge,
    prompts::Prompts,
    record::Record,
    rollout::Rollout,
    text_file,
};

/// Example of a panel file, with every key.
pub const EXAMPLE_YAML: &str = include_str!("../../judges.yaml");

/// A panel file.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PanelSettings {
    /// Frames shown to all judges.
    #[serde(default)]
    pub frames: FrameChoice,
    /// Judges with distinct names.
    pub judges: Vec<EndpointSettings>,
}

impl PanelSettings {
    /// Reads a file like [`EXAMPLE_YAML`].
    ///
    /// # Errors
    /// If it cannot be read, and those of [`Self::parse`].
    pub fn read(path: &Path) -> Result<Self> {
        Self::parse(&text_file::read(path)?)
    }

    /// Parses a text like [`EXAMPLE_YAML`].
    ///
    /// # Errors
    /// For a missing or unknown key, an invalid value, no judge, or equal names.
    pub fn parse(yaml: &str) -> Result<Self> {
        let settings: Self = text_file::parse("a file of judges", yaml)?;
        settings.check()?;
        Ok(settings)
    }

    fn check(&self) -> Result<()> {
        self.frames.check()?;
        let failed = |found: String| Error::Setting {
            owner: "judges".to_owned(),
            setting: "name",
            found,
            expected: "at least one judge, each with another name",
        };
        if self.judges.is_empty() {
            return Err(failed("there for none".to_owned()));
        }
        let mut names = BTreeSet::new();
        for judge in &self.judges {
            judge.check()?;
            if !names.insert(&judge.name) {
                return Err(failed(format!("{:?} twice", judge.name)));
            }
        }
        Ok(())
    }
}

/// Scores of rollouts, by judge.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Ratings {
    /// Names of the judges.
    pub judges: Vec<String>,
    /// 0, 0.5 or 1, as `[judge][rollout]`; `None` for an unusable answer.
    pub scores: Vec<Vec<Option<f64>>>,
}

impl Ratings {
    /// Number of rollouts without a score, by judge.
    #[must_use]
    pub fn unusable(&self) -> Vec<usize> {
        let rows = self.scores.iter();
        rows.map(|row| row.iter().filter(|score| score.is_none()).count())
            .collect()
    }
}

/// A rating of one rollout by one judge.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Progress<'a> {
    /// Name of the judge.
    pub judge: &'a str,
    /// Index of the rollout.
    pub rollout: usize,
    /// Score.
    pub score: Option<f64>,
    /// Whether it comes from an earlier run.
    pub from_record: bool,
}

/// Judges that all rate every rollout.
#[derive(Debug)]
pub struct Panel {
    judges: Vec<Judge>,
}

impl Panel {
    /// The judges of a file. Sends nothing yet.
    ///
    /// # Errors
    /// If a setting is invalid, or the environment lacks an API key.
    pub fn new(settings: PanelSettings, prompts: Arc<Prompts>) -> Result<Self> {
        Self::with_clock(settings, prompts, Arc::new(SystemClock::default()))
    }

    /// [`Self::new`] with another clock.
    ///
    /// # Errors
    /// Those of [`Self::new`].
    pub fn with_clock(
        settings: PanelSettings,
        prompts: Arc<Prompts>,
        clock: Arc<dyn Clock>,
    ) -> Result<Self> {
        settings.check()?;
        let frames = settings.frames;
        let judges = settings.judges.into_iter().map(|judge| {
            Judge::with_clock(judge, Arc::clone(&prompts), frames, Arc::clone(&clock))
        });
        Ok(Self {
            judges: judges.collect::<Result<_>>()?,
        })
    }

    /// The judges, for single questions: in the paper, only one fills the rubric.
    pub fn judges(&mut self) -> &mut [Judge] {
        &mut self.judges
    }

    /// Rates the success of every rollout by every judge, one question after another. Rollouts are taken one at a time,
    /// so that an iterator may load them.
    ///
    /// # Errors
    /// Those of [`Judge::success`] for the first failing judge. Earlier answers are in the record, and the same call
    /// resumes there.
    pub fn success<R: Borrow<Rollout>>(
        &mut self,
        rollouts: impl IntoIterator<Item = R>,
        record: &mut Record,
        mut progress: impl FnMut(Progress<'_>),
    ) -> Result<Ratings> {
        let mut ratings = Ratings {
            judges: self
                .judges
                .iter()
                .map(|judge| judge.name().to_owned())
                .collect(),
            scores: vec![Vec::new(); self.judges.len()],
        };
        for (number, rollout) in rollouts.into_iter().enumerate() {
            for (judge, row) in self.judges.iter_mut().zip(&mut ratings.scores) {
                let judged = judge.success(rollout.borrow(), record)?;
                let score = judged.verdict.map(f64::from);
                row.push(score);
                progress(Progress {
                    judge: judge.name(),
                    rollout: number,
                    score,
                    from_record: judged.from_record,
                });
            }
        }
        Ok(ratings)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn example_has_every_key_with_its_default() {
        let settings = PanelSettings::parse(EXAMPLE_YAML).unwrap();
        assert_eq!(settings.frames, FrameChoice::default());
        let [first, second] = &settings.judges[..] else {
            panic!("{settings:?}");
        };
        let model = "OpenGVLab/InternVL3_5-14B";
        assert_eq!(
            *first,
            EndpointSettings::new("internvl", "http://127.0.0.1:8000/v1", model)
        );
        let keys = serde_json::to_value(first).unwrap();
        for key in keys.as_object().unwrap().keys() {
            assert!(
                EXAMPLE_YAML.contains(&format!(" {key}:")),
                "{key} is missing"
            );
        }
        assert_eq!(second.max_tokens, Some(8192));
    }

    #[test]
    fn invalid_panels_are_rejected() {
        let judge = "{name: a, base_url: 'http://localhost', model: m}";
        for (yaml, named) in [
            ("judges: []".to_owned(), "at least one judge"),
            (format!("judges: [{judge}, {judge}]"), "\"a\" twice"),
            (
                format!("{{frames: {{whole: 0, tail: 0}}, judges: [{judge}]}}"),
                "1 to 256",
            ),
            (format!("{{frame: 1, judges: [{judge}]}}"), "frame"),
        ] {
            let error = PanelSettings::parse(&yaml).unwrap_err().to_string();
            assert!(error.contains(named), "{error}");
        }
    }
}
