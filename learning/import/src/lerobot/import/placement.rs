//! Assigns frames of a video to episodes.
//!
//! A video has the frames of one or several consecutive episodes. The start of an episode follows from the lengths of the
//! earlier episodes and from `from_timestamp`. If these disagree, the number of frames in the file decides; an episode with
//! an uncertain place is rejected by name.

use std::{collections::BTreeMap, ops::Range};

/// An episode of a video, from `meta`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Member {
    pub index: i64,
    /// Number of rows, and frames.
    pub length: usize,
    /// `from_timestamp` \[s\].
    pub from_s: f64,
}

/// Presentation times of a video's frames \[s\], sorted.
pub(super) struct Times<'a>(pub &'a [f64]);

/// The frames of an episode, and a remark.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Frames {
    pub range: Range<usize>,
    pub note: Option<&'static str>,
}

/// By episode: its frames, or why they are uncertain.
pub(super) type Placement = BTreeMap<i64, Result<Frames, String>>;

/// Tolerance of a start against the sum of earlier lengths \[frames\]: times are rounded once per episode.
const TOLERANCE: usize = 3;
/// Tolerance of a frame's time \[frames\].
const QUARTER: f64 = 0.25;
const SURPLUS: &str = "the video has frames after the last row of the episode, which are ignored";
const DRIFT: &str =
    "from_timestamp differs from the lengths of the episodes before, which agree with the video";

impl Times<'_> {
    fn count(&self) -> usize {
        self.0.len()
    }

    /// Median frame period \[s\].
    pub fn period_s(&self) -> Option<f64> {
        let pairs = self.0.iter().zip(self.0.iter().skip(1));
        let mut gaps: Vec<f64> = pairs.map(|(before, after)| after - before).collect();
        gaps.sort_unstable_by(f64::total_cmp);
        gaps.get(gaps.len() / 2).copied().filter(|gap| *gap > 0.0)
    }

    /// The frame at a time, within a quarter of a period.
    fn at(&self, time_s: f64, period_s: f64) -> Option<usize> {
        let after = self.0.partition_point(|shown| *shown < time_s);
        let candidates = [after.checked_sub(1), Some(after)].into_iter().flatten();
        let distance = |frame: &usize| {
            let shown = self.0.get(*frame);
            shown.map_or(f64::INFINITY, |shown| (shown - time_s).abs())
        };
        let nearest = candidates.min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
        (distance(&nearest) <= QUARTER * period_s).then_some(nearest)
    }
}

/// Places the episodes `members` of a video with frames at `times`; `fps` is the data set's.
pub(super) fn place(times: &Times<'_>, fps: f64, members: &[Member]) -> Placement {
    let mut members = members.to_vec();
    members.sort_by_key(|member| member.index);
    let total = times.count();
    // Saturating: lengths in metadata may be arbitrary.
    let lengths = members.iter().map(|member| member.length);
    let rows = lengths.fold(0, usize::saturating_add);
    let period_s = times.period_s().unwrap_or(fps.recip());
    if let [only] = members.as_slice()
        && only.from_s < QUARTER * period_s
    {
        return BTreeMap::from([(only.index, place_single(only, total))]);
    }
    if rows == total {
        return place_by_lengths(times, fps, period_s, &members);
    }
    // A gap in time shows a missing frame.
    let last_s = times.0.last().copied().unwrap_or(0.0);
    let begin_s = times.0.first().copied().unwrap_or(0.0);
    let spanned = (((last_s - begin_s) / period_s).round() as usize).saturating_add(1);
    match spanned > total {
        true => place_by_times(times, period_s, begin_s, spanned, &members),
        false => place_by_begins(times, period_s, rows, &members),
    }
}

/// Places the episode of a video with one episode.
fn place_single(member: &Member, total: usize) -> Result<Frames, String> {
    if total < member.length {
        return Err(format!(
            "expected {} frames, one for each row of episode {}, got {total}",
            member.length, member.index
        ));
    }
    Ok(Frames {
        range: 0..member.length,
        note: (total > member.length).then_some(SURPLUS),
    })
}

/// Places episodes of a video with as many frames as rows: each starts where the previous one ends, unless `from_timestamp`
/// clearly differs.
fn place_by_lengths(times: &Times<'_>, fps: f64, period_s: f64, members: &[Member]) -> Placement {
    let shortest = members.iter().map(|member| member.length).min();
    // A file without members has nothing to place.
    let tolerance = TOLERANCE.min(shortest.unwrap_or(0) / 2).max(1) as f64;
    // In frames, by the video's clock and by the data set's, which differ if the video was encoded at another rate.
    let off = |member: &Member, begin: usize| {
        let of_clock = |rate: f64| member.from_s * rate - begin as f64;
        let (own, other) = (of_clock(period_s.recip()), of_clock(fps));
        if own.abs() < other.abs() { own } else { other }
    };
    let begins = |members: &[Member]| -> Vec<usize> {
        let mut next = 0;
        members
            .iter()
            .map(|member| {
                next += member.length;
                next - member.length
            })
            .collect()
    };
    let in_order = |members: &[Member]| {
        let offsets = members.iter().zip(begins(members));
        offsets
            .map(|(member, begin)| off(member, begin))
            .collect::<Vec<f64>>()
    };
    // Merged data sets may have another order.
    let mut by_time = members.to_vec();
    by_time.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
    let is_other_order = in_order(&by_time).iter().all(|off| off.abs() <= tolerance);
    let members = if is_other_order {
        by_time.as_slice()
    } else {
        members
    };
    let mut drift = 0.0;
    let mut placement = Placement::new();
    for (member, begin) in members.iter().zip(begins(members)) {
        let off = off(member, begin);
        // Drift accumulates over episodes, and does not jump.
        let is_near = off.abs() <= tolerance || (off - drift).abs() <= 1.5;
        let result = if is_near {
            drift = off;
            Ok(Frames {
                range: begin..begin + member.length,
                note: (off.abs() > QUARTER).then_some(DRIFT),
            })
        } else {
            Err(format!(
                "episode {} begins at {} s by from_timestamp, and at frame {begin}, {:.3} s, by the lengths of the episodes \
                 before it",
                member.index,
                member.from_s,
                times.0.get(begin).copied().unwrap_or(f64::NAN)
            ))
        };
        placement.insert(member.index, result);
    }
    placement
}

/// Places episodes of a video with missing frames, if times show where: each frame is found by its time.
fn place_by_times(
    times: &Times<'_>,
    period_s: f64,
    begin_s: f64,
    spanned: usize,
    members: &[Member],
) -> Placement {
    let end = |member: &Member| {
        let begin = ((member.from_s - begin_s) / period_s).round() as i64;
        begin.saturating_add(i64::try_from(member.length).unwrap_or(i64::MAX))
    };
    // A file without members has nothing to place.
    let last = members.iter().map(end).max().unwrap_or(0);
    let is_accounted = last == spanned as i64;
    let frames = |member: &Member| {
        if !is_accounted {
            return Err(format!(
                "its frames span {spanned} periods, and its episodes end after {last}: where frames of episode {} are is \
                 uncertain",
                member.index
            ));
        }
        let mut first = None;
        for row in 0..member.length {
            let at_s = member.from_s + row as f64 * period_s;
            let found = times.at(at_s, period_s);
            let begin = *first.get_or_insert(found.unwrap_or(0));
            if found != Some(begin + row) {
                return Err(format!(
                    "frame {row} of the {} of episode {} is missing: expected it at {at_s:.3} s",
                    member.length, member.index
                ));
            }
        }
        let begin = first.unwrap_or(0);
        Ok(Frames {
            range: begin..begin + member.length,
            note: None,
        })
    };
    let placed = members.iter().map(|member| (member.index, frames(member)));
    let mut placement: Placement = placed.collect();
    reject_overlaps(&mut placement);
    placement
}

/// Places episodes of a video with another number of frames than rows: each starts at its `from_timestamp`, if all
/// together account for all frames.
fn place_by_begins(times: &Times<'_>, period_s: f64, rows: usize, members: &[Member]) -> Placement {
    let total = times.count();
    let mut placement = Placement::new();
    for member in members {
        let begin = times.at(member.from_s, period_s);
        let result = match begin {
            None => Err(format!(
                "episode {} begins at {} s, where the video of {total} frames has none",
                member.index, member.from_s
            )),
            Some(begin) => Ok(Frames {
                range: begin..begin.saturating_add(member.length),
                note: None,
            }),
        };
        placement.insert(member.index, result);
    }
    let placed: Vec<Range<usize>> = placement
        .values()
        .flatten()
        .map(|frames| frames.range.clone())
        .collect();
    // Without placed members the end is the first row.
    let end = placed.iter().map(|range| range.end).max().unwrap_or(0);
    let shortest = members
        .iter()
        .map(|member| member.length)
        .min()
        .unwrap_or(1);
    // The surplus is shorter than an episode: its owner is unknown.
    if end > total || (1..shortest).contains(&(total - end.min(total))) {
        for (index, result) in &mut placement {
            if result.is_ok() {
                *result = Err(format!(
                    "it has {total} frames for the {rows} rows of its {} episodes: which frames are those of episode {index} \
                     is uncertain",
                    members.len()
                ));
            }
        }
        return placement;
    }
    reject_overlaps(&mut placement);
    placement
}

/// Rejects all episodes that share a frame with another.
fn reject_overlaps(placement: &mut Placement) {
    let mut sorted: Vec<(i64, Range<usize>)> = placement
        .iter()
        .filter_map(|(index, result)| Some((*index, result.as_ref().ok()?.range.clone())))
        .collect();
    sorted.sort_by_key(|(_, range)| (range.start, range.end));
    let mut overlaps = Vec::new();
    // Of the episodes so far, the one with the latest end: an episode that overlaps any overlaps it.
    let mut last: Option<&(i64, Range<usize>)> = None;
    for next in &sorted {
        if let Some((index, range)) = last
            && next.1.start < range.end
        {
            overlaps.push((*index, next.0, next.1.start));
            overlaps.push((next.0, *index, next.1.start));
        }
        if last.is_none_or(|(_, range)| range.end < next.1.end) {
            last = Some(next);
        }
    }
    for (index, other, frame) in overlaps {
        let reason = format!(
            "frame {frame} belongs to episode {index} and to episode {other} by from_timestamp"
        );
        placement.insert(index, Err(reason));
    }
}

#[cfg(test)]
mod tests;
