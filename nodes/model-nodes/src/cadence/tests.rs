#![allow(clippy::unwrap_used)]

use super::*;

const PERIOD: Duration = Duration::from_millis(200);

/// What became of the inputs of a virtual camera.
#[derive(Debug, Default)]
struct Run {
    /// Inputs that were worked on, and how old each was when that began.
    used: Vec<(usize, Duration)>,
    skipped: usize,
    late: usize,
}

impl Run {
    /// How far apart the inputs are that were used after `settled` ones.
    fn distances(&self, settled: usize) -> Vec<usize> {
        let used: Vec<usize> = self.used.iter().map(|(input, _)| *input).collect();
        let gaps = used.windows(2).map(|pair| pair[1] - pair[0]);
        gaps.skip(settled).collect()
    }
}

/// Feeds `inputs`, `period` apart, to work that takes `taken` of each input, with a place for one that waits.
fn run(
    cadence: &mut Cadence,
    inputs: usize,
    period: Duration,
    taken: impl Fn(usize) -> Duration,
) -> Run {
    let begin = Instant::now();
    let at = |input: usize| begin + period * u32::try_from(input).unwrap();
    let mut run = Run::default();
    let (mut running, mut waiting): (Option<(usize, Instant)>, Option<usize>) = (None, None);
    let finish = |cadence: &mut Cadence,
                  run: &mut Run,
                  running: &mut Option<(usize, Instant)>,
                  waiting: &mut Option<usize>,
                  now: Instant| {
        while let Some((input, end)) = running.filter(|(_, end)| *end <= now) {
            *running = waiting.take().map(|next| {
                cadence.begun(end);
                run.used.push((next, end - at(next)));
                (next, end + taken(next))
            });
            cadence.took(taken(input));
        }
    };
    for input in 0..inputs {
        let now = at(input);
        finish(cadence, &mut run, &mut running, &mut waiting, now);
        let load = match (running, waiting) {
            (None, _) => Load::Idle,
            (Some(_), None) => Load::Busy,
            (Some(_), Some(_)) => Load::Waiting,
        };
        let stamp_ns = i64::try_from(input).unwrap();
        match cadence.arrived(stamp_ns, now, load) {
            Verdict::Skip => run.skipped += 1,
            verdict if load == Load::Idle => {
                assert_eq!(verdict, Verdict::Use);
                run.used.push((input, Duration::ZERO));
                running = Some((input, now + taken(input)));
            }
            verdict => {
                run.skipped += usize::from(verdict == Verdict::Replace);
                run.late += usize::from(verdict == Verdict::ReplaceLate);
                assert_eq!(verdict == Verdict::Use, waiting.replace(input).is_none());
            }
        }
    }
    finish(
        cadence,
        &mut run,
        &mut running,
        &mut waiting,
        at(inputs) + Duration::from_secs(3600),
    );
    assert_eq!(
        run.used.len() + run.skipped + run.late,
        inputs,
        "each counts once"
    );
    run
}

#[test]
fn at_any_speed_every_nth_input_is_used_and_it_is_the_newest() {
    for (tenths, nth) in [
        (5, 1),
        (9, 1),
        (15, 2),
        (18, 2),
        (25, 3),
        (75, 8),
        (80, 8),
        (550, 55),
    ] {
        let taken = PERIOD * tenths / 10;
        // As the node measured it before the first input.
        let mut cadence = Cadence::new(PERIOD, Some(taken));
        let inputs = 40 * nth;
        let found = run(&mut cadence, inputs, PERIOD, |_| taken);
        // What is not believed at first takes a few runs to settle, and some more to catch up.
        let settled = if (11..=20).contains(&tenths) { 8 } else { 0 };
        assert!(
            found
                .distances(settled)
                .iter()
                .all(|distance| *distance == nth),
            "{tenths} tenths: {found:?}"
        );
        assert!(
            found
                .used
                .iter()
                .skip(settled)
                .all(|(_, age)| age.is_zero()),
            "work begins when its input comes: {found:?}"
        );
        let lost = if settled > 0 { 2 } else { 0 };
        assert!(found.late <= lost, "{found:?}");
        assert_eq!(cadence.nth() as usize, nth);
    }
}

#[test]
fn what_was_never_measured_settles_within_a_few_runs() {
    let mut cadence = Cadence::new(PERIOD, None);
    let taken = PERIOD * 15 / 2;
    let found = run(&mut cadence, 400, PERIOD, |_| taken);
    assert!(
        found.distances(4).iter().all(|distance| *distance == 8),
        "{found:?}"
    );
    assert!(found.late > 0, "until then inputs are dropped");
}

#[test]
fn a_hiccup_changes_nothing_and_a_slower_machine_does() {
    let mut cadence = Cadence::new(PERIOD, None);
    let hiccup = |input: usize| match input % 10 {
        0 => PERIOD * 3,
        _ => PERIOD / 2,
    };
    let found = run(&mut cadence, 100, PERIOD, hiccup);
    assert_eq!((cadence.nth(), cadence.change()), (1, None));
    assert!(
        found.skipped == 0 && found.late > 0,
        "an overload is no choice: {found:?}"
    );

    run(&mut cadence, 100, PERIOD, |_| PERIOD * 3 / 2);
    assert_eq!(cadence.change(), Some((PERIOD * 3 / 2, PERIOD)));
    assert_eq!((cadence.nth(), cadence.change()), (2, None), "said once");
    // It would fit, but not with a margin: n does not swing.
    run(&mut cadence, 100, PERIOD, |_| PERIOD * 95 / 100);
    assert_eq!(cadence.nth(), 2);
    run(&mut cadence, 100, PERIOD, |_| PERIOD / 2);
    assert_eq!(cadence.change(), Some((PERIOD / 2, PERIOD)));
    assert_eq!(cadence.nth(), 1);
}

#[test]
fn a_bag_that_is_played_slowly_leaves_time_for_every_input() {
    let taken = PERIOD * 7;
    let mut cadence = Cadence::new(PERIOD, Some(taken));
    assert_eq!(cadence.nth(), 7);
    let found = run(&mut cadence, 100, PERIOD * 10, |_| taken);
    assert_eq!(cadence.nth(), 1);
    assert!(
        found.distances(10).iter().all(|distance| *distance == 1),
        "{found:?}"
    );
}

/// The frames of a slow encoder come once in a while: the next one is used if the work is over.
#[test]
fn inputs_that_come_slower_than_was_thought_are_used_at_once() {
    let taken = PERIOD * 13;
    let mut cadence = Cadence::new(PERIOD, Some(taken));
    assert_eq!(cadence.nth(), 13);
    let found = run(&mut cadence, 10, PERIOD * 26, |_| taken);
    assert_eq!((found.used.len(), cadence.nth()), (10, 1));
}

#[test]
fn a_time_measured_at_the_start_counts_only_if_it_is_long() {
    assert_eq!(Cadence::new(PERIOD, Some(PERIOD * 2)).nth(), 1);
    assert_eq!(Cadence::new(PERIOD, Some(PERIOD * 5 / 2)).nth(), 3);
}

/// A machine that was busy while the node started: the first run shows that the estimate was wrong.
#[test]
fn an_estimate_far_too_long_costs_one_run_only() {
    let mut cadence = Cadence::new(PERIOD, Some(PERIOD * 20));
    assert_eq!(cadence.nth(), 20);
    let found = run(&mut cadence, 50, PERIOD, |_| PERIOD / 2);
    assert_eq!((cadence.nth(), found.used.len()), (1, 50), "{found:?}");
}

#[test]
fn twice_the_work_takes_twice_as_long_at_once() {
    let mut cadence = Cadence::new(PERIOD, Some(PERIOD * 4));
    cadence.scale(2.0);
    assert_eq!(cadence.nth(), 8);
    cadence.scale(0.25);
    assert_eq!(cadence.nth(), 1);
    run(&mut cadence, 100, PERIOD, |_| PERIOD * 2);
    assert_eq!(cadence.nth(), 2);
    cadence.scale(2.0);
    assert_eq!((cadence.nth(), cadence.interval()), (4, PERIOD * 4));
}
