use std::collections::BTreeMap;

use wm_motion::{actions::ActionSpace, motion::Pace};

use super::{
    Settings,
    action_log::Alignment,
    manifest::Thing,
    options::Cut,
    recording::{Picture, Recording},
};

/// An episode without its pictures.
#[derive(Clone, Debug, Default)]
pub(super) struct Draft {
    /// Stamp of the first frame of its episode, which gaps may divide into several drafts \[ns\].
    pub episode_ns: i64,
    /// Stamps of the frames' pictures \[ns\], by stream.
    pub stamps: Vec<Vec<i64>>,
    /// Log times of the first and the last picture \[ns\].
    pub logged_ns: (u64, u64),
    /// Motion from each frame to the next.
    pub actions: Vec<Vec<f32>>,
    /// State at each frame, in the action's dimensions; NaN if unknown.
    pub states: Vec<Vec<f32>>,
    pub instruction: Option<String>,
    pub success: Option<bool>,
    /// Meaning of the mask values.
    pub labels: BTreeMap<u8, String>,
}

impl Draft {
    /// Stamps of the first and the last frame \[ns\].
    pub fn span_ns(&self) -> (i64, i64) {
        // `cut` makes no draft without streams or frames.
        let main = self.stamps.first().map(Vec::as_slice).unwrap_or_default();
        let ends = main.first().zip(main.last());
        ends.map_or((0, 0), |(first, last)| (*first, *last))
    }
}

/// Excluded frames, with the reason.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Omission {
    pub span_ns: Option<(i64, i64)>,
    pub count: u64,
    pub thing: Thing,
    pub reason: String,
}

/// A frame: the pictures of all streams at one time.
struct Moment {
    /// Index among the first camera's pictures.
    place: usize,
    pictures: Vec<Picture>,
    stamp_ns: i64,
}

/// Frames without a gap.
struct Part {
    moments: Vec<Moment>,
    /// Whether it continues the episode of the part before it, after a gap.
    continues: bool,
}

/// Cuts a recording into episodes of frames one action period apart, with the motion between them.
///
/// # Errors
/// A description if the camera is slower than the model.
pub(super) fn cut(
    recording: &Recording,
    space: &ActionSpace,
    settings: &Settings,
) -> Result<(Vec<Draft>, Vec<Omission>), String> {
    // The rate is at least 0.01 Hz.
    let period_ns = (1e9 / space.rate()) as i64;
    let mut cutter = Cutter {
        recording,
        settings,
        period_ns,
        alignment: Alignment::new(&recording.actions, space, period_ns, settings.shift_actions),
        actions_unknown: Omission {
            span_ns: None,
            count: 0,
            thing: Thing::Frame,
            reason: format!(
                "no message on {} within a period of the frame",
                recording.action_topic
            ),
        },
        drafts: Vec::new(),
        omissions: Vec::new(),
        episode_ns: None,
    };
    for (count, thing, what) in &recording.complaints {
        cutter.omissions.push(Omission {
            span_ns: None,
            count: *count,
            thing: *thing,
            reason: what.clone(),
        });
    }
    let moments = cutter.moments();
    // A single frame has no gap.
    let gap_ns = median_gap(&moments).unwrap_or(period_ns);
    if gap_ns > period_ns + period_ns / 2 {
        return Err(format!(
            "the camera has a frame every {:.2} s, but actions of {} Hz need one every {:.2} s",
            gap_ns as f64 / 1e9,
            space.rate(),
            period_ns as f64 / 1e9
        ));
    }
    let parts = cutter.parts(moments, gap_ns);
    for (index, part) in parts.iter().enumerate() {
        let next = parts.get(index + 1).and_then(|part| part.moments.first());
        if !part.continues {
            cutter.episode_ns = None;
        }
        cutter.align(
            &part.moments,
            next.map(|moment| moment.place),
            parts.len() == 1,
        );
    }
    if cutter.actions_unknown.count > 0 {
        cutter.omissions.push(cutter.actions_unknown);
    }
    Ok((cutter.drafts, cutter.omissions))
}

struct Cutter<'a> {
    recording: &'a Recording,
    settings: &'a Settings,
    period_ns: i64,
    alignment: Alignment<'a>,
    /// Frames without known actions.
    actions_unknown: Omission,
    drafts: Vec<Draft>,
    omissions: Vec<Omission>,
    /// Stamp of the first frame of the current episode, if it has a draft \[ns\].
    episode_ns: Option<i64>,
}

impl Cutter<'_> {
    /// The first camera's pictures, each with the nearest picture of all other streams within half a period.
    fn moments(&mut self) -> Vec<Moment> {
        let Some((main, others)) = self.recording.streams.split_first() else {
            return Vec::new();
        };
        let mut alone = vec![0_u64; others.len()];
        let mut moments = Vec::with_capacity(main.pictures.len());
        'pictures: for (place, picture) in main.pictures.iter().enumerate() {
            let mut pictures = Vec::with_capacity(1 + others.len());
            pictures.push(*picture);
            for (other, alone) in others.iter().zip(&mut alone) {
                let Some(partner) = other.nearest(picture.stamp_ns, self.period_ns / 2) else {
                    *alone += 1;
                    continue 'pictures;
                };
                pictures.push(partner);
            }
            moments.push(Moment {
                place,
                pictures,
                stamp_ns: picture.stamp_ns,
            });
        }
        for (other, count) in others.iter().zip(alone).filter(|(_, count)| *count > 0) {
            let tolerance = self.period_ns as f64 / 2e9;
            self.omissions.push(Omission {
                span_ns: None,
                count,
                thing: Thing::Frame,
                reason: format!("no frame of {} within {tolerance:.2} s", other.topic),
            });
        }
        moments
    }

    /// Frames one period apart, split where no motion may be learned across.
    fn parts(&self, moments: Vec<Moment>, gap_ns: i64) -> Vec<Part> {
        let longest_ns = self.settings.gap_periods * self.period_ns as f64;
        let mut cuts = self.recording.cuts.clone();
        if self.settings.cut.contains(&Cut::Instruction) {
            let instructions = &self.recording.instructions;
            let changes = instructions.iter().zip(instructions.iter().skip(1));
            cuts.extend(
                changes
                    .filter(|((_, before), (_, after))| before != after)
                    .map(|(_, (place, _))| *place),
            );
        }
        cuts.sort_unstable();
        let mut pace = Pace::new(self.period_ns, gap_ns);
        let mut parts: Vec<Part> = Vec::new();
        let mut before: Option<(usize, i64)> = None;
        for moment in moments {
            let (mut is_gap, mut is_cut) = (false, before.is_none());
            if let Some((place, stamp_ns)) = before {
                // A message between that picture and this one.
                let is_between = |places: &[usize]| {
                    let next = places.partition_point(|at| *at <= place);
                    places.get(next).is_some_and(|at| *at <= moment.place)
                };
                let begun = parts.last().and_then(|part| part.moments.first());
                let is_long = self.settings.cut_seconds.is_some_and(|seconds| {
                    // The frame nearest to the cut starts the part, since stamps jitter.
                    let end_ns = seconds * 1e9 - (gap_ns / 2).min(self.period_ns / 4) as f64;
                    begun.is_some_and(|begun| (moment.stamp_ns - begun.stamp_ns) as f64 >= end_ns)
                });
                is_gap = (moment.stamp_ns - stamp_ns) as f64 > longest_ns
                    || is_between(&self.recording.breaks);
                is_cut = is_long || is_between(&cuts);
            }
            before = Some((moment.place, moment.stamp_ns));
            if is_gap || is_cut {
                pace.restart();
                parts.push(Part {
                    moments: Vec::new(),
                    continues: !is_cut,
                });
            }
            if pace.is_due(moment.stamp_ns)
                && let Some(part) = parts.last_mut()
            {
                part.moments.push(moment);
            }
        }
        parts
    }

    /// Makes episodes of a part, split where actions are missing. `next` is the start of the next part.
    fn align(&mut self, part: &[Moment], next: Option<usize>, is_only: bool) {
        let mut run: Vec<(&Moment, Vec<f32>)> = Vec::new();
        for (index, moment) in part.iter().enumerate() {
            let following = part.get(index + 1);
            let to_ns = match following {
                Some(following) => following.stamp_ns,
                None => moment.stamp_ns.saturating_add(self.period_ns),
            };
            let interval = self.alignment.between(moment.stamp_ns, to_ns);
            let is_known = interval.as_ref().is_some_and(|interval| interval.is_given);
            match interval {
                // No action is needed after the last frame, and some data sets record none.
                Some(interval) if is_known || !run.is_empty() => {
                    run.push((moment, interval.values));
                }
                _ => {
                    self.actions_unknown.count += 1;
                    let span_ns = &mut self.actions_unknown.span_ns;
                    let (begin_ns, _) = span_ns.unwrap_or((moment.stamp_ns, 0));
                    *span_ns = Some((begin_ns, moment.stamp_ns));
                }
            }
            if !is_known && !run.is_empty() {
                let run = std::mem::take(&mut run);
                self.finish(&run, following.map(|m| m.place).or(next), is_only);
            }
        }
        if !run.is_empty() {
            self.finish(&run, next, is_only);
        }
    }

    fn finish(&mut self, run: &[(&Moment, Vec<f32>)], next: Option<usize>, is_only: bool) {
        let (Some((first, _)), Some((last, _))) = (run.first(), run.last()) else {
            return;
        };
        let span_ns = (first.stamp_ns, last.stamp_ns);
        let seconds = (span_ns.1 - span_ns.0 + self.period_ns) as f64 / 1e9;
        // Tolerates a nanosecond of rounding.
        if seconds + 1e-6 < self.settings.min_seconds {
            self.omissions.push(Omission {
                span_ns: Some(span_ns),
                count: run.len() as u64,
                thing: Thing::Frame,
                reason: format!(
                    "an episode of {seconds:.2} s; the minimum is {} s",
                    self.settings.min_seconds
                ),
            });
            return;
        }
        let stream_count = self.recording.streams.len();
        let mut draft = Draft {
            episode_ns: *self.episode_ns.get_or_insert(span_ns.0),
            stamps: vec![Vec::with_capacity(run.len()); stream_count],
            logged_ns: (u64::MAX, 0),
            instruction: at(&self.recording.instructions, first.place, last.place)
                .filter(|text| !text.is_empty())
                .cloned(),
            labels: at(&self.recording.labels, first.place, last.place)
                .cloned()
                .unwrap_or_default(),
            success: self.success(first.place, next, is_only),
            ..Draft::default()
        };
        for (moment, action) in run {
            for (stamps, picture) in draft.stamps.iter_mut().zip(&moment.pictures) {
                stamps.push(picture.stamp_ns);
                let (from, to) = draft.logged_ns;
                draft.logged_ns = (from.min(picture.logged_ns), to.max(picture.logged_ns));
            }
            draft.actions.push(action.clone());
        }
        self.drafts.push(draft);
    }

    /// The last success between the first frame and the next episode; of the whole bag for an only episode.
    fn success(&self, first: usize, next: Option<usize>, is_only: bool) -> Option<bool> {
        let is_of_it =
            |place: &usize| is_only || (*place > first && next.is_none_or(|next| *place <= next));
        let mut successes = self.recording.successes.iter();
        let last = successes.rfind(|(place, _)| is_of_it(place));
        last.map(|(_, success)| *success)
    }
}

/// The value at the first frame, or the first one during the episode.
fn at<T>(values: &[(usize, T)], first: usize, last: usize) -> Option<&T> {
    let before = values.iter().rfind(|(place, _)| *place <= first);
    let later = || values.iter().find(|(place, _)| *place <= last + 1);
    before.or_else(later).map(|(_, values)| values)
}

/// The median gap: a single jittery pair is no evidence of the rate.
fn median_gap(moments: &[Moment]) -> Option<i64> {
    let pairs = moments.iter().zip(moments.iter().skip(1));
    let mut gaps: Vec<i64> = pairs.map(|(a, b)| b.stamp_ns - a.stamp_ns).collect();
    gaps.sort_unstable();
    gaps.get(gaps.len() / 2).copied()
}
