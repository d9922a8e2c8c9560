use std::path::Path;

use rayon::prelude::*;
use wm_audit::{ActionTrack, BagFindings, Finding};
use wm_bag::BagReader;
use wm_motion::actions::ActionSpace;
use wm_program::progress::Progress;

use super::BagPlan;
use crate::{
    DatasetError, Settings,
    cutting::{Draft, Omission, cut},
    manifest::{LeftOut, Source},
    recording::{BrokenPictures, Recording, has_joints},
    unusable_bag::UnusableBag,
};

/// Readable bags with their common action space.
pub(super) struct Survey {
    /// One per source; false for an excluded bag. Bags are opened when they are read: thousands of open ones would take
    /// gigabytes for their indices.
    is_readable: Vec<bool>,
    space: ActionSpace,
    left_out: Vec<LeftOut>,
}

/// The episodes of all bags.
pub(super) struct Plan {
    pub bags: Vec<BagPlan>,
    pub space: ActionSpace,
    /// Topics without transports.
    pub cameras: Vec<String>,
    pub has_masks: bool,
    pub left_out: Vec<LeftOut>,
    /// Faults of each bag's stamps and pictures.
    pub findings: Vec<BagFindings>,
}

/// Contents of a bag.
struct Contents {
    cameras: Vec<String>,
    topics: Vec<String>,
    has_masks: bool,
    has_cut_topic: bool,
    episodes: Vec<Draft>,
    omissions: Vec<Omission>,
    findings: Vec<Finding>,
    actions: ActionTrack,
    /// Sizes of the first camera's pictures, width and height \[px\].
    sizes: Vec<(u32, u32)>,
}

impl Survey {
    /// Opens the bags and compares their action spaces.
    pub fn of(sources: &[Source], settings: &Settings) -> Result<Self, DatasetError> {
        let opened: Vec<_> = sources
            .par_iter()
            .map(|source| open(source, settings))
            .collect();
        let mut survey = Self {
            is_readable: Vec::with_capacity(sources.len()),
            space: ActionSpace::bridge(),
            left_out: Vec::new(),
        };
        let requested = settings.action_space.clone();
        let mut first = requested.map(|space| (space, "--action-space".to_owned()));
        for (source, opened) in sources.iter().zip(opened) {
            let bag = &source.bag;
            survey.is_readable.push(opened.is_ok());
            let (warnings, space) = match opened {
                Ok(opened) => opened,
                Err(reason) => {
                    survey.left_out.push(LeftOut::path(bag, &reason));
                    continue;
                }
            };
            for warning in warnings {
                tracing::warn!("{}", LeftOut::path(bag, &warning));
            }
            let others = bag.display().to_string();
            match (&first, space) {
                (Some((expected, own)), Some(space)) => {
                    let same = expected.expect_same(&space, own, &others);
                    same.map_err(|error| refused(bag, error))?;
                    if settings.action_space.is_none()
                        && let Some(remark) = rate_remark(&space, expected, own)
                    {
                        tracing::warn!("{}", LeftOut::path(bag, &remark));
                    }
                }
                (Some(_), None) => {}
                (None, space) => {
                    first = Some((space.unwrap_or_else(ActionSpace::bridge), others));
                }
            }
        }
        if let Some((space, _)) = first {
            survey.space = space;
        }
        Ok(survey)
    }

    /// Episodes of all bags, without the pictures in `broken`, by source.
    pub fn plan(
        &self,
        sources: &[Source],
        settings: &Settings,
        broken: &[BrokenPictures],
    ) -> Result<Plan, DatasetError> {
        let progress = Progress::of("reading", "bags", sources.len() as u64);
        let readable = sources.par_iter().zip(&self.is_readable);
        let contents: Vec<_> = (readable.zip(broken))
            .map(|((source, is_readable), broken)| {
                let contents = is_readable.then(|| {
                    let reader = reader(source).map_err(UnusableBag::Lacks)?;
                    contents(&reader, settings, &self.space, broken)
                });
                progress.inc(1);
                contents
            })
            .collect();
        drop(progress);
        let mut plan = Plan {
            bags: Vec::new(),
            space: self.space.clone(),
            cameras: Vec::new(),
            has_masks: false,
            left_out: self.left_out.clone(),
            findings: Vec::new(),
        };
        let mut first: Option<&Path> = None;
        let mut has_cut_topic = settings.cut_topics.is_empty();
        for (index, (source, contents)) in sources.iter().zip(contents).enumerate() {
            let bag = source.bag.as_path();
            let contents = match contents {
                None => continue,
                Some(Ok(contents)) => contents,
                Some(Err(UnusableBag::Lacks(reason))) => {
                    plan.left_out.push(LeftOut::path(bag, &reason));
                    continue;
                }
                Some(Err(UnusableBag::Differs(what))) => return Err(refused(bag, what)),
            };
            let left = contents.omissions.iter().map(|omission| LeftOut {
                path: bag.to_owned(),
                span_ns: omission.span_ns,
                count: Some((omission.count, omission.thing)),
                reason: omission.reason.clone(),
            });
            plan.left_out.extend(left);
            has_cut_topic |= contents.has_cut_topic;
            let stem = bag.file_stem().unwrap_or_default();
            let clocks = contents
                .findings
                .iter()
                .find(|f| f.check == "stamps" && f.is_fault());
            let clocks = clocks.map_or(String::new(), |finding| {
                let fix = finding.fix.as_deref().unwrap_or_default();
                format!("; {}; {fix}", finding.what)
            });
            plan.findings.push(BagFindings {
                bag: stem.to_string_lossy().into_owned(),
                findings: contents.findings,
                sizes: contents.sizes,
            });
            if contents.episodes.is_empty() {
                let reason = format!("no episodes{clocks}");
                plan.left_out.push(LeftOut::path(bag, &reason));
                continue;
            }
            if let Some(first) = first {
                plan.expect_same(bag, (&contents.cameras, contents.has_masks), first)?;
            } else {
                first = Some(bag);
                plan.cameras = contents.cameras;
                plan.has_masks = contents.has_masks;
            }
            plan.bags.push(BagPlan {
                source: index,
                topics: contents.topics,
                episodes: contents.episodes,
                actions: contents.actions,
                findings: plan.findings.len() - 1,
            });
        }
        if plan.bags.is_empty() {
            let reasons = plan.left_out.iter().map(|left| format!("    {left}"));
            return Err(DatasetError::Nothing(
                reasons.collect::<Vec<_>>().join("\n"),
            ));
        }
        if !has_cut_topic {
            return Err(DatasetError::Option {
                option: "--cut-topic",
                what: format!("no bag has {}", settings.cut_topics.join(" or ")),
            });
        }
        Ok(plan)
    }
}

impl Plan {
    /// Rejects a bag whose cameras differ from the first bag's.
    fn expect_same(
        &self,
        bag: &Path,
        (cameras, has_masks): (&[String], bool),
        first: &Path,
    ) -> Result<(), DatasetError> {
        if *cameras != self.cameras {
            let (own, first) = (cameras.join(", "), first.display());
            let expected = self.cameras.join(", ");
            let what = format!(
                "cameras differ: it has {own}, but {first} has {expected}; choose with --camera"
            );
            return Err(refused(bag, what));
        }
        if has_masks != self.has_masks {
            let what = "some bags have masks and some do not; expected all or none";
            return Err(refused(bag, what));
        }
        Ok(())
    }
}

fn refused(bag: &Path, what: impl ToString) -> DatasetError {
    DatasetError::Episode {
        bag: bag.to_owned(),
        what: what.to_string(),
    }
}

/// The warning about a bag whose rate differs from the data set's; `own` is the bag that set that rate.
fn rate_remark(space: &ActionSpace, expected: &ActionSpace, own: &str) -> Option<String> {
    (space.rate() != expected.rate()).then(|| {
        format!(
            "its rate is {} Hz, but the data set gets the {} Hz of {own}; --action-space sets another rate",
            space.rate(),
            expected.rate()
        )
    })
}

/// The reader of a source's bag.
pub(super) fn reader(source: &Source) -> Result<BagReader, String> {
    BagReader::open(&source.bag).map_err(|error| error.to_string())
}

/// A bag's warnings and its declared action space. Without `--action-space`, an undeclared one is Bridge V2's.
fn open(
    source: &Source,
    settings: &Settings,
) -> Result<(Vec<String>, Option<ActionSpace>), String> {
    let reader = reader(source)?;
    let warnings = reader.warnings().iter().map(ToString::to_string).collect();
    let note = reader.note(ActionSpace::NOTE);
    // The declared space is that of wm_msgs/Action. For joints, the user chooses the values.
    let is_free = note.is_none() || has_joints(&reader, &settings.action_topic);
    if is_free && settings.action_space.is_some() {
        return Ok((warnings, None));
    }
    let space = ActionSpace::of_note(note).map_err(|error| error.to_string())?;
    Ok((warnings, Some(space)))
}

fn contents(
    reader: &BagReader,
    settings: &Settings,
    space: &ActionSpace,
    broken: &BrokenPictures,
) -> Result<Contents, UnusableBag> {
    let mut recording = Recording::read(reader, settings, space, broken)?;
    let (mut episodes, omissions) = cut(&recording, space, settings).map_err(UnusableBag::Lacks)?;
    let path = std::mem::take(&mut recording.state).path(space);
    for episode in &mut episodes {
        let stamps = episode.stamps.first().into_iter().flatten();
        episode.states = stamps.map(|stamp_ns| path.at(*stamp_ns)).collect();
    }
    let camera = recording.recorded.cameras.first();
    let sizes = camera.map(|camera| camera.pictures.sizes().keys().copied().collect());
    let actions = ActionTrack::new(space, recording.actions.rows());
    Ok(Contents {
        findings: recording.findings(settings, space, &actions),
        actions,
        sizes: sizes.unwrap_or_default(),
        cameras: recording.cameras(),
        topics: recording.streams.iter().map(|s| s.topic.clone()).collect(),
        has_masks: recording.has_masks,
        has_cut_topic: recording.has_cut_topic,
        episodes,
        omissions,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bag_of_another_rate_is_named() {
        let slower = ActionSpace::bridge().at_rate(4.0).unwrap();
        let remark = |space| rate_remark(space, &slower, "first.mcap");
        assert_eq!(remark(&slower), None);
        let found = remark(&ActionSpace::bridge()).unwrap();
        let expected = "its rate is 5 Hz, but the data set gets the 4 Hz of first.mcap";
        assert!(found.starts_with(expected), "{found}");
    }
}
