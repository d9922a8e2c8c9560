//! Measures the units of suites in parallel, and makes findings of them.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use anyhow::Result;
use rayon::prelude::*;
use wm_metrics::findings::{Header, ModelFindings, Section, Suite};
use wm_program::progress::Progress;

use crate::{
    Settings, Shard, Subject,
    control::{self, Control},
    cost, fidelity,
    policy::{self, Setup, Trials},
    records::{Heading, Record, Records, UnitResult},
    representation::{self, Representations},
    robustness,
};

/// Suites of an evaluation with their units.
struct Plan<'a> {
    subject: &'a Subject,
    settings: &'a Settings,
    suites: Vec<SuiteUnits<'a>>,
    /// Suites without sufficient data, with reasons.
    absent: BTreeMap<Suite, String>,
}

enum SuiteUnits<'a> {
    Fidelity(Vec<usize>),
    Control(Control<'a>),
    Latents(Representations<'a>),
    Policy(Trials<'a>),
    Robustness(Vec<(usize, usize)>),
    Cost,
}

impl<'a> SuiteUnits<'a> {
    /// `None` if the model lacks a part that the suite needs.
    fn new(
        suite: Suite,
        subject: &'a Subject,
        settings: &'a Settings,
        (setup, records): (&'a Setup, (&Path, Shard)),
    ) -> Result<Option<Self>> {
        Ok(match suite {
            // The findings report a missing decoder.
            Suite::Fidelity if subject.decoder.is_none() => Some(Self::Fidelity(Vec::new())),
            Suite::Fidelity => {
                let units = fidelity::units(subject, &settings.fidelity);
                Some(Self::Fidelity(units))
            }
            Suite::Control => Some(Self::Control(Control::new(subject, settings)?)),
            Suite::Latents => Some(Self::Latents(Representations::new(subject, settings)?)),
            Suite::Policy => Some(Self::Policy(Trials::new(
                subject, settings, setup, records,
            )?)),
            Suite::Robustness => Some(Self::Robustness(robustness::units(subject, settings))),
            Suite::Cost => Some(Self::Cost),
            _ => None,
        })
    }

    fn suite(&self) -> Suite {
        match self {
            Self::Fidelity(_) => Suite::Fidelity,
            Self::Control(_) => Suite::Control,
            Self::Latents(_) => Suite::Latents,
            Self::Policy(_) => Suite::Policy,
            Self::Robustness(_) => Suite::Robustness,
            Self::Cost => Suite::Cost,
        }
    }

    /// Names of the units.
    fn names(&self, subject: &Subject) -> Vec<String> {
        let episodes = subject.dataset.episodes();
        let episode = |index: &usize| episodes.get(*index).map_or("", |e| &e.name).to_owned();
        match self {
            Self::Fidelity(units) => units.iter().map(episode).collect(),
            Self::Control(control) => control.names(),
            Self::Latents(representations) => representations.names(),
            Self::Policy(trials) => trials.names(),
            Self::Robustness(units) => {
                let units = units.iter();
                units
                    .map(|(index, start)| format!("{} from frame {start}", episode(index)))
                    .collect()
            }
            Self::Cost => vec!["model".into()],
        }
    }

    fn measure(&self, subject: &Subject, settings: &Settings, unit: usize) -> Result<UnitResult> {
        let seed = settings.seed.wrapping_add(unit as u64);
        let none = || anyhow::anyhow!("no unit {unit}");
        Ok(match self {
            Self::Fidelity(units) => {
                let own = &settings.fidelity;
                let episode = *units.get(unit).ok_or_else(none)?;
                let shown = unit < own.strips;
                let found = fidelity::measure(subject, own, seed, episode, shown)?;
                UnitResult::Fidelity(found)
            }
            Self::Control(control) => UnitResult::Control(control.measure(unit)?),
            Self::Latents(representations) => UnitResult::Latents(representations.measure(unit)?),
            Self::Policy(trials) => UnitResult::Policy(trials.measure(unit)?),
            Self::Robustness(units) => {
                let window = *units.get(unit).ok_or_else(none)?;
                let found = robustness::measure(subject, settings, seed, window)?;
                UnitResult::Robustness(found)
            }
            Self::Cost => UnitResult::Cost(cost::measure(subject)?),
        })
    }
}

/// Measures the units of this shard that the records lack; returns the path of the records.
///
/// # Errors
/// If a suite cannot be measured, or records cannot be read or written.
pub fn measure(
    subject: &Subject,
    (data, position): (&[PathBuf], usize),
    suites: &[Suite],
    settings: &Settings,
    setup: &Setup,
    (folder, shard): (&Path, Shard),
) -> Result<PathBuf> {
    let mut plan = Plan {
        subject,
        settings,
        suites: Vec::new(),
        absent: BTreeMap::new(),
    };
    for suite in suites {
        match SuiteUnits::new(*suite, subject, settings, (setup, (folder, shard))) {
            Ok(planned) => plan.suites.extend(planned),
            // Episodes too short for one suite may suffice for others.
            Err(error) if suites.len() > 1 && matches!(suite, Suite::Control | Suite::Latents) => {
                plan.absent.insert(*suite, format!("{error:#}"));
            }
            Err(error) => return Err(error),
        }
    }
    let heading = plan.heading(data, position)?;
    let hash: String = heading.header.hash.chars().take(12).collect();
    let name = Path::new(&heading.header.model).file_name();
    let name = name.map_or("model".into(), |name| name.to_string_lossy());
    let words = name.split(|c: char| !(c.is_alphanumeric() || "._-".contains(c)));
    let words: Vec<&str> = words.filter(|word| !word.is_empty()).collect();
    let path = folder.join(format!("{}-{hash}.{shard}.jsonl", words.join("-")));
    let records = Records::open(&path, &heading)?;
    plan.run(&records, shard)?;
    Ok(path)
}

impl Plan<'_> {
    fn heading(&self, data: &[PathBuf], position: usize) -> Result<Heading> {
        let Subject { world, dataset, .. } = self.subject;
        let suites = self.suites.iter();
        let units = suites.map(|planned| (planned.suite(), planned.names(self.subject).len()));
        Ok(Heading {
            position,
            units: units.collect(),
            absent: self.absent.clone(),
            header: Header {
                model: self.subject.name(),
                hash: world.hash.clone(),
                space: world.space.name.clone(),
                data: data.iter().map(|path| path.display().to_string()).collect(),
                data_digest: dataset.recordings_digest().to_owned(),
                episodes: dataset.episodes().len(),
                left_out: dataset.left_out().map(ToString::to_string).collect(),
                seed: self.settings.seed,
                settings: serde_json::to_value(self.settings)?,
                sampler: serde_json::to_value(self.subject.sampler())?,
                readers: self.subject.readers.hashes.clone(),
                version: env!("CARGO_PKG_VERSION").into(),
            },
        })
    }

    fn run(&self, records: &Records, shard: Shard) -> Result<()> {
        let mut pending = Vec::new();
        let mut timed = Vec::new();
        let mut number = 0;
        for planned in &self.suites {
            for (unit, name) in planned.names(self.subject).into_iter().enumerate() {
                // Shards split the units of all suites together, so that small suites are shared too.
                if shard.has(number) && !records.has(planned.suite(), unit) {
                    match planned {
                        SuiteUnits::Cost => timed.push((planned, unit, name)),
                        _ => pending.push((planned, unit, name)),
                    }
                }
                number += 1;
            }
        }
        let total = pending.len() + timed.len();
        if !records.is_empty() {
            let (done, path) = (records.len(), records.path().display());
            println!("{done} units were measured earlier, in {path}");
        }
        let progress = Progress::of("measuring", "units", total as u64);
        let one = |(planned, unit, name): &(&SuiteUnits<'_>, usize, String)| -> Result<()> {
            let found = planned.measure(self.subject, self.settings, *unit)?;
            records.keep(&Record {
                suite: planned.suite(),
                unit: *unit,
                name: name.clone(),
                found,
            })?;
            progress.inc(1);
            Ok(())
        };
        // One unit at a time: durations differ, and chunks would leave threads idle.
        pending.par_iter().with_max_len(1).try_for_each(one)?;
        // Alone, since they measure time.
        timed.iter().try_for_each(one)?;
        drop(progress);
        Ok(())
    }
}

/// Findings of merged records, in order.
///
/// # Errors
/// If this program cannot read the settings of the heading.
pub fn findings(heading: Heading, records: Vec<Record>) -> Result<ModelFindings> {
    let settings: Settings = serde_json::from_value(heading.header.settings.clone())?;
    let mut fidelities = Vec::new();
    let mut controls = Vec::new();
    let mut latents = Vec::new();
    let mut policies = Vec::new();
    let mut robustnesses = Vec::new();
    let mut costs = Vec::new();
    for Record { name, found, .. } in records {
        match found {
            UnitResult::Fidelity(found) => fidelities.push((name, found)),
            UnitResult::Control(found) => controls.push((name, found)),
            UnitResult::Latents(found) => latents.push((name, found)),
            UnitResult::Policy(found) => policies.push((name, found)),
            UnitResult::Robustness(found) => robustnesses.push((name, found)),
            UnitResult::Cost(found) => costs.push((name, found)),
        }
    }
    let too_short = heading.absent.iter().map(|(suite, why)| {
        let mut section = Section::new(*suite);
        section.absent(suite.name(), why);
        section
    });
    let sections = heading.units.keys().map(|suite| match suite {
        Suite::Fidelity => fidelity::summarise(&fidelities, &settings),
        Suite::Control => control::summarise(&controls, &settings),
        Suite::Latents => representation::summarise(&latents, &settings),
        Suite::Policy => policy::summarise(&policies, &settings),
        Suite::Robustness => robustness::summarise(&robustnesses, &settings),
        Suite::Cost => cost::summarise(&costs),
        suite => Section::new(*suite),
    });
    Ok(ModelFindings {
        sections: sections.chain(too_short).collect(),
        header: heading.header,
    })
}
