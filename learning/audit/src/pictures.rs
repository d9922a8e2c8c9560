//! Checks of a camera's pictures: repeats, freezes, sizes, rate.

use crate::{Finding, gaps::Gaps};
use std::collections::BTreeMap;
use wm_camera::{recent_pictures::RecentPictures, signature::Signature};

/// Limit of pictures per camera: an hour at 30 Hz, 1.3 MB.
const PICTURES_LIMIT: usize = 108_000;
/// Mean change that is only noise \[levels\]. Of 48,000 real frames with the arm in motion, none stayed below it for more
/// than 0.9 s.
const STILL: f32 = 0.3;
/// A picture repeats an earlier one if its change is below this share of the changes around it. In real motion, 0.7 % of
/// 25,000 frames do, at most 1.5 % of one camera.
const REPEAT_SHARE: f32 = 0.08;
/// Change around a picture that is motion \[levels\].
const IN_MOTION: f32 = 1.0;
/// Number of pictures on each side in which motion is searched, for compared pictures.
const NEIGHBOURS: usize = 3;
/// As [`NEIGHBOURS`], for pictures that are equal byte for byte.
const NEIGHBOURS_EQUAL: usize = 12;
/// Share of repeats that is a fault.
const REPEATS: f64 = 0.05;
/// Minimum number of pairs in motion for a verdict about repeats.
const PAIRS_MIN: u64 = 10;
/// Standstill during activity of the robot that is a freeze \[s\].
const FROZEN_S: f64 = 2.0;
/// As [`FROZEN_S`] \[pictures\].
const FROZEN_PICTURES: usize = 12;
/// Activity of the robot that should change pictures, as a share of its strong actions.
const ACTS: f32 = 0.3;
/// Activity of an idle robot, as a share of its strong actions.
pub(crate) const IDLE: f32 = 0.05;
/// Share of missing frames that is a fault. A real arm (Dobot CR5) whose stamps jitter by a third of a period seems to miss
/// up to 7 %.
const MISSING: f64 = 0.08;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Change {
    /// The bytes differ; the pictures were not compared.
    Unknown,
    /// The bytes equal those of a recent picture.
    Equal,
    /// Mean absolute difference \[levels\].
    Levels(f32),
}

impl Change {
    /// In levels; infinite for pictures that were not compared.
    fn levels(self) -> f32 {
        match self {
            Self::Unknown => f32::INFINITY,
            Self::Equal => 0.0,
            Self::Levels(levels) => levels,
        }
    }
}

/// A picture and its predecessor.
#[derive(Clone, Copy, Debug)]
struct Pair {
    /// Time of capture \[ns\].
    at_ns: i64,
    change: Change,
    /// Whether it equals the first picture of the standstill.
    is_still: bool,
}

/// The pictures of a camera in the order of arrival: a few numbers each.
#[derive(Clone, Debug, Default)]
pub struct Pictures {
    /// The topic.
    pub topic: String,
    first_ns: Option<i64>,
    pairs: Vec<Pair>,
    beyond: u64,
    gaps: Gaps,
    sizes: BTreeMap<(u32, u32), u64>,
    last: Option<(u64, Option<Signature>)>,
    recent: RecentPictures,
    last_ns: i64,
    /// Signature of the first picture of a standstill.
    anchor: Option<Signature>,
}

/// Activity of the robot between two times \[ns\], as a share of its strong actions; `None` if unknown.
pub type Activity<'a> = &'a dyn Fn(i64, i64) -> Option<f32>;

impl Pictures {
    /// A camera without pictures.
    #[must_use]
    pub fn new(topic: &str) -> Self {
        Self {
            topic: topic.to_owned(),
            ..Self::default()
        }
    }

    /// Adds the next picture: time of capture \[ns\], fingerprint, width and height \[px\], and signature if it was decoded.
    /// Returns the mean change since the previous picture \[levels\], if both were decoded or are equal.
    pub fn push(
        &mut self,
        at_ns: i64,
        fingerprint: u64,
        size: Option<(u32, u32)>,
        signature: Option<Signature>,
    ) -> Option<f32> {
        if let Some(size) = size {
            *self.sizes.entry(size).or_default() += 1;
        }
        let is_new = self.recent.insert(fingerprint);
        let levels = self.last.as_ref().and_then(|(before, shown)| {
            if *before == fingerprint {
                return Some(0.0);
            }
            let (before, now) = shown.as_ref().zip(signature.as_ref())?;
            before.change(now)
        });
        let change = self.last.as_ref().map(|_| match (is_new, levels) {
            (false, _) => Change::Equal,
            (true, Some(levels)) => Change::Levels(levels),
            (true, None) => Change::Unknown,
        });
        let of_anchor = self.anchor.as_ref().zip(signature.as_ref());
        let of_anchor = of_anchor.and_then(|(anchor, now)| anchor.change(now));
        let is_still = change == Some(Change::Equal) || of_anchor.is_some_and(|of| of < STILL);
        if !is_still {
            self.anchor.clone_from(&signature);
        }
        self.last = Some((fingerprint, signature));
        match change {
            None => self.first_ns = Some(at_ns),
            Some(_) if self.pairs.len() >= PICTURES_LIMIT => self.beyond += 1,
            Some(change) => {
                self.gaps.push(at_ns.saturating_sub(self.last_ns));
                self.pairs.push(Pair {
                    at_ns,
                    change,
                    is_still,
                });
            }
        }
        self.last_ns = at_ns;
        levels
    }

    /// Adds the pictures of a later part of the recording; those at the joint are not compared.
    pub fn append(&mut self, later: Self) {
        let Some(first_ns) = later.first_ns else {
            return;
        };
        match self.first_ns {
            None => self.first_ns = Some(first_ns),
            Some(_) => self.push_pair(Pair {
                at_ns: first_ns,
                change: Change::Unknown,
                is_still: false,
            }),
        }
        for pair in later.pairs {
            self.push_pair(pair);
        }
        self.beyond += later.beyond;
        self.gaps.append(&later.gaps);
        for (size, count) in later.sizes {
            *self.sizes.entry(size).or_default() += count;
        }
        (self.last, self.last_ns) = (later.last, later.last_ns);
        self.recent = later.recent;
        self.anchor = later.anchor;
    }

    fn push_pair(&mut self, pair: Pair) {
        match self.pairs.len() < PICTURES_LIMIT {
            true => self.pairs.push(pair),
            false => self.beyond += 1,
        }
    }

    /// The number of pictures.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.first_ns
            .map_or(0, |_| 1 + self.pairs.len() as u64 + self.beyond)
    }

    /// Number of pictures by width and height \[px\].
    #[must_use]
    pub fn sizes(&self) -> &BTreeMap<(u32, u32), u64> {
        &self.sizes
    }

    /// Successive pairs with their times \[ns\].
    fn spans(&self) -> impl Iterator<Item = (i64, &Pair)> {
        let begins = self.pairs.iter().map(|pair| pair.at_ns);
        let begins = self.first_ns.into_iter().chain(begins);
        begins.zip(&self.pairs)
    }

    /// Number of repeats among pictures in motion, and number of pictures in motion.
    fn count_repeats(&self, activity: Option<Activity<'_>>) -> (u64, u64) {
        let (mut repeats, mut in_motion) = (0, 0);
        for (index, (from_ns, pair)) in self.spans().enumerate() {
            let around = if pair.change == Change::Equal {
                NEIGHBOURS_EQUAL
            } else {
                NEIGHBOURS
            };
            let most = |pairs: Option<&[Pair]>| {
                // In range: both ranges end within `pairs`.
                let levels = pairs.unwrap_or_default().iter().map(|p| p.change.levels());
                levels.fold(0.0, f32::max)
            };
            let before = most(self.pairs.get(index.saturating_sub(around)..index));
            let end = self.pairs.len().min(index + 1 + around);
            let after = most(self.pairs.get(index + 1..end));
            let moved = before.min(after);
            let acts = activity.and_then(|activity| activity(from_ns, pair.at_ns));
            // Without noise, pictures of an idle robot are equal.
            if acts.is_some_and(|acts| acts < IDLE) {
                continue;
            }
            let levels = pair.change.levels();
            let is_near = moved.is_finite() && levels < REPEAT_SHARE * moved;
            let is_repeat = moved >= IN_MOTION && (pair.change == Change::Equal || is_near);
            repeats += u64::from(is_repeat);
            in_motion += u64::from(is_repeat || levels >= IN_MOTION);
        }
        (repeats, in_motion)
    }

    /// Standstills during activity of the robot: begin, end \[ns\], number of pictures.
    fn find_freezes(&self, activity: Option<Activity<'_>>) -> Vec<(i64, i64, usize)> {
        let spans: Vec<(i64, &Pair)> = self.spans().collect();
        let runs = spans.chunk_by(|(_, a), (_, b)| a.is_still == b.is_still);
        let runs = runs.filter(|run| run.first().is_some_and(|(_, pair)| pair.is_still));
        let frozen = runs.filter_map(|run| {
            let (from_ns, _) = run.first()?;
            let (_, last) = run.last()?;
            let seconds = last.at_ns.saturating_sub(*from_ns) as f64 / 1e9;
            if seconds < FROZEN_S || run.len() < FROZEN_PICTURES {
                return None;
            }
            let acts = run.iter().filter(|(from_ns, pair)| {
                let acts = activity.and_then(|activity| activity(*from_ns, pair.at_ns));
                acts.is_some_and(|acts| acts > ACTS)
            });
            (acts.count() * 2 > run.len()).then_some((*from_ns, last.at_ns, run.len()))
        });
        frozen.collect()
    }

    /// Checks the pictures. `activity`: the robot's motion, if known.
    #[must_use]
    pub fn check(&self, activity: Option<Activity<'_>>) -> Vec<Finding> {
        let mut findings: Vec<Finding> = self.check_sizes().into_iter().collect();
        findings.extend(self.check_standstill(activity));
        findings.extend(self.check_repeats(activity));
        findings.extend(self.check_missing());
        if self.beyond > 0 {
            let what = format!(
                "{}: the first {} pictures were examined, {} more were not",
                self.topic,
                self.count() - self.beyond,
                self.beyond
            );
            findings.push(Finding::note("frames", what));
        }
        findings
    }

    fn check_sizes(&self) -> Option<Finding> {
        if self.sizes.len() < 2 {
            return None;
        }
        let mut sizes: Vec<_> = self.sizes.iter().collect();
        sizes.sort_by_key(|(_, count)| std::cmp::Reverse(**count));
        let shown = sizes.iter().take(4);
        let shown = shown.map(|((width, height), count)| format!("{count} of {width}x{height}"));
        let shown = shown.collect::<Vec<_>>().join(", ");
        let what = format!("{}: the size of the pictures changes: {shown}", self.topic);
        Some(
            Finding::warning("sizes", what)
                .because("pictures of different sizes are scaled differently: the view jumps")
                .fix("record one size; split this recording where the size changes (wm bag cut)")
                .figure("sizes", self.sizes.len() as f64),
        )
    }

    fn check_standstill(&self, activity: Option<Activity<'_>>) -> Option<Finding> {
        let frozen = self.find_freezes(activity);
        let pictures: usize = frozen.iter().map(|(_, _, pictures)| pictures).sum();
        let seconds = |(from_ns, to_ns, _): &(i64, i64, usize)| (to_ns - from_ns) as f64 / 1e9;
        let total_s: f64 = frozen.iter().map(seconds).sum();
        let share = pictures as f64 / self.pairs.len().max(1) as f64;
        let topic = &self.topic;
        if let Some(first) = frozen.first() {
            let (level, what): (fn(_, String) -> Finding, _) = if share > 0.9 {
                let what = format!(
                    "{topic}: frozen: {pictures} pictures show the same for {total_s:.1} s while the robot acts"
                );
                (Finding::error, what)
            } else {
                let what = format!(
                    "{topic}: frozen for {total_s:.1} s ({:.0} % of the pictures) while the robot acts, first from {} ns on",
                    share * 100.0,
                    first.0
                );
                (Finding::warning, what)
            };
            let finding = level("frozen", what)
                .because("a model learns that actions change nothing")
                .fix("check driver and cable of the camera; remove these parts (wm bag cut)");
            return Some(
                finding
                    .figure("frozen_s", total_s)
                    .figure("frozen_share", share),
            );
        }
        let is_standing = self.pairs.len() >= FROZEN_PICTURES
            && self.pairs.iter().all(|pair| pair.is_still)
            && activity.is_none();
        is_standing.then(|| {
            let what = format!(
                "{topic}: all {} pictures show the same, and no actions are known: the camera is frozen, or nothing moves",
                self.count()
            );
            Finding::note("frozen", what)
                .fix("move an object in front of the camera and check again")
        })
    }

    fn check_repeats(&self, activity: Option<Activity<'_>>) -> Option<Finding> {
        let (repeats, in_motion) = self.count_repeats(activity);
        let period_s = self.gaps.median_s()?;
        if in_motion < PAIRS_MIN {
            return None;
        }
        let share = repeats as f64 / in_motion as f64;
        if share < REPEATS {
            return None;
        }
        let rate = 1.0 / period_s;
        let true_rate = rate * (1.0 - share);
        let what = format!(
            "{}: {:.0} % of the pictures repeat an earlier one: {rate:.1} Hz come, {true_rate:.1} Hz differ",
            self.topic,
            share * 100.0
        );
        Some(
            Finding::warning("repeats", what)
                .because("a model learns from repeated pictures that actions change nothing")
                .fix(format!(
                    "set the rate of the driver to that of the camera ({true_rate:.0} Hz), or prepare the data at a rate that \
                     is no higher (rate in --action-space)"
                ))
                .figure("repeated_share", share)
                .figure("rate_hz", rate)
                .figure("true_rate_hz", true_rate),
        )
    }

    fn check_missing(&self) -> Option<Finding> {
        let (missing, longest_s) = self.gaps.missing();
        let came = self.count();
        let share = missing as f64 / (came + missing).max(1) as f64;
        let what = format!(
            "{}: {missing} of {} frames are missing ({:.1} %); the longest gap lasts {longest_s:.2} s",
            self.topic,
            came + missing,
            share * 100.0
        );
        let finding = if share > MISSING {
            Finding::warning("dropped", what)
                .because("episodes end at missing frames")
                .fix("record on a faster disk, publish /compressed, or lower the rate (wm doctor shows lost frames)")
        } else if missing > 0 {
            Finding::note("dropped", what)
        } else {
            return None;
        };
        Some(
            finding
                .figure("missing", missing as f64)
                .figure("missing_share", share)
                .figure("longest_gap_s", longest_s),
        )
    }

    /// The finding for a camera without a fault.
    #[must_use]
    pub fn summary(&self) -> Finding {
        let rate = self.gaps.median_s().map(|period_s| 1.0 / period_s);
        let sizes = self.sizes.keys().next();
        let size = sizes.map_or(String::new(), |(width, height)| {
            format!("{width}x{height}, ")
        });
        let rate_text = rate.map_or(String::new(), |rate| format!(" at {rate:.1} Hz"));
        let what = format!("{}: {size}{} pictures{rate_text}", self.topic, self.count());
        Finding::ok("frames", what)
            .figure("pictures", self.count() as f64)
            .figure("rate_hz", rate.unwrap_or(f64::NAN))
    }
}

#[cfg(test)]
mod tests;
