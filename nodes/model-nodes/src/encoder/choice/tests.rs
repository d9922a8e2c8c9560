#![allow(clippy::unwrap_used)]

use std::collections::VecDeque;

use super::*;

const PERIOD: Duration = Duration::from_millis(200);
const PERIOD_NS: i64 = 200_000_000;

fn needs(frame_skip: usize, context_frames: usize) -> Needs {
    Needs {
        frame_period: PERIOD,
        frame_skip,
        context_frames,
    }
}

/// The fates of the frames of a virtual camera.
#[derive(Debug, Default)]
struct Run {
    /// Stamps of the encoded frames \[ns\], and how old each was when its latent was there.
    encoded: Vec<(i64, Duration)>,
    skipped: usize,
    late: usize,
}

impl Run {
    /// Frames with a whole context: one model step apart, within a quarter of a period.
    fn contexts(&self, needs: &Needs) -> Vec<(i64, Duration)> {
        let step_ns = nanos(needs.step());
        let has = |stamp_ns: i64| {
            let near = |(other_ns, _): &(i64, _)| (other_ns - stamp_ns).abs() <= PERIOD_NS / 4;
            self.encoded.iter().any(near)
        };
        let is_whole = |stamp_ns: i64| {
            (1..needs.context_frames as i64).all(|back| has(stamp_ns - back * step_ns))
        };
        let whole = self
            .encoded
            .iter()
            .filter(|(stamp_ns, _)| is_whole(*stamp_ns));
        whole.copied().collect()
    }
}

/// Frames of these stamps, each coming `pace` times its stamp after the first, to an encoder that takes `taken` a frame.
fn run(choice: &mut Choice, stamps: &[i64], pace: f64, taken: Duration) -> Run {
    let begin = Instant::now();
    let first_ns = stamps[0];
    let at = |stamp_ns: i64| {
        begin + Duration::from_nanos(u64::try_from(stamp_ns - first_ns).unwrap()).mul_f64(pace)
    };
    let mut run = Run::default();
    let mut running: Option<(i64, Instant)> = None;
    let mut waiting: VecDeque<i64> = VecDeque::new();
    let finish = |choice: &mut Choice,
                  run: &mut Run,
                  running: &mut Option<(i64, Instant)>,
                  waiting: &mut VecDeque<i64>,
                  now: Instant| {
        while let Some((stamp_ns, end)) = running.filter(|(_, end)| *end <= now) {
            run.encoded.push((stamp_ns, end - at(stamp_ns)));
            choice.took(taken);
            *running = waiting.pop_front().map(|next_ns| (next_ns, end + taken));
        }
    };
    for stamp_ns in stamps.iter().copied() {
        let now = at(stamp_ns);
        finish(choice, &mut run, &mut running, &mut waiting, now);
        match choice.arrived(stamp_ns, now, waiting.len()) {
            Fate::Skip => run.skipped += 1,
            Fate::Late => run.late += 1,
            Fate::Encode if running.is_none() => running = Some((stamp_ns, now + taken)),
            Fate::Encode => {
                if waiting.len() >= choice.room() {
                    waiting.pop_front();
                    run.late += 1;
                }
                waiting.push_back(stamp_ns);
            }
        }
    }
    let end = begin + Duration::from_secs(100_000);
    finish(choice, &mut run, &mut running, &mut waiting, end);
    let accounted = run.encoded.len() + run.skipped + run.late;
    assert_eq!(accounted, stamps.len(), "each counts once");
    run
}

fn stamps(count: i64) -> Vec<i64> {
    // Cameras jitter.
    let jitter = [0, 9, -12, 5, -7, 0, 12, -4];
    let stamp = |frame: i64| frame * PERIOD_NS + jitter[(frame % 8) as usize] * 1_000_000;
    (0..count).map(stamp).collect()
}

/// The rate that each speed allows: (encoding in tenths of a period, frame_skip, context_frames), and how many camera
/// frames lie between one whole context and the next.
#[test]
fn at_any_speed_whole_contexts_come_at_the_rate_that_it_allows() {
    for ((tenths, skip, context), frames) in [
        ((5, 2, 2), 1),
        ((15, 2, 2), 2),
        ((20, 2, 2), 2),
        // Two frames of three periods each, once in three model steps of two frames.
        ((30, 2, 2), 6),
        ((100, 2, 2), 20),
        ((100, 2, 1), 10),
        // The least divisor of four that is enough.
        ((15, 4, 2), 2),
        ((30, 4, 2), 4),
        ((30, 1, 2), 6),
        ((30, 3, 4), 3),
        ((50, 2, 4), 20),
    ] {
        let taken = PERIOD * tenths / 10;
        let needs = needs(skip, context);
        let mut choice = Choice::new(needs, Some(taken));
        let found = run(&mut choice, &stamps(60 * frames), 1.0, taken);
        assert_eq!(choice.mode(), Mode::of(taken, &needs));
        assert_eq!(choice.mode().interval(&needs), PERIOD * frames as u32);
        let contexts = found.contexts(&needs);
        // What is not believed at first takes a few frames to settle; the last context may be cut off.
        let expected = 50..=60;
        assert!(
            expected.contains(&contexts.len()),
            "{tenths} tenths, {needs:?}: {} contexts, {found:?}",
            contexts.len()
        );
        let settled = contexts.iter().skip(8);
        let gaps = settled.clone().zip(settled.clone().skip(1));
        for ((one, _), (next, _)) in gaps {
            let distance = (next - one + PERIOD_NS / 2) / PERIOD_NS;
            assert_eq!(distance, frames, "{tenths} tenths, {needs:?}: {found:?}");
        }
        // The newest frame of a context waits for those before it, and for nothing else.
        let encoding = taken * context as u32;
        let spanned = needs.step() * (context as u32 - 1);
        let oldest = taken.max(encoding.saturating_sub(spanned)) + PERIOD / 5;
        assert!(
            settled.clone().all(|(_, age)| *age <= oldest),
            "{tenths} tenths: {found:?}"
        );
        assert!(found.late <= 4, "{tenths} tenths: {found:?}");
    }
}

#[test]
fn a_slow_encoder_that_was_never_measured_settles() {
    let needs = needs(2, 2);
    let mut choice = Choice::new(needs, None);
    assert_eq!(choice.mode(), Mode::All);
    let found = run(&mut choice, &stamps(400), 1.0, PERIOD * 11 / 2);
    assert_eq!(choice.change(), Some(PERIOD * 11 / 2));
    assert_eq!((choice.mode(), choice.change()), (Mode::Contexts(6), None));
    assert!(found.contexts(&needs).len() > 25, "{found:?}");
}

/// A machine that was busy while the node started: the first frame shows that the estimate was wrong.
#[test]
fn an_estimate_far_too_long_costs_few_frames() {
    let needs = needs(2, 2);
    let mut choice = Choice::new(needs, Some(PERIOD * 20));
    assert_eq!(choice.mode(), Mode::Contexts(20));
    let found = run(&mut choice, &stamps(50), 1.0, PERIOD / 2);
    assert_eq!(choice.mode(), Mode::All);
    assert!(found.encoded.len() >= 48, "{found:?}");
}

#[test]
fn a_fast_encoder_takes_the_models_frames_of_a_faster_camera() {
    let needs = needs(2, 2);
    let mut choice = Choice::new(needs, None);
    let stamps: Vec<i64> = (0..300).map(|tick| tick * PERIOD_NS / 6).collect();
    let found = run(&mut choice, &stamps, 1.0, Duration::from_millis(90));
    assert_eq!(choice.mode(), Mode::Every(1));
    let contexts = found.contexts(&needs).len();
    assert!((45..=60).contains(&contexts), "{contexts}: {found:?}");
}

#[test]
fn a_bag_that_is_played_slowly_leaves_time_for_every_frame() {
    let needs = needs(2, 2);
    let taken = PERIOD * 7;
    let mut choice = Choice::new(needs, Some(taken));
    assert_eq!(choice.mode(), Mode::Contexts(7));
    let found = run(&mut choice, &stamps(200), 9.0, taken);
    assert_eq!(choice.mode(), Mode::All);
    assert!(found.contexts(&needs).len() > 150, "{found:?}");
}

#[test]
fn a_lost_frame_costs_its_context_and_no_other() {
    let needs = needs(2, 2);
    let taken = PERIOD * 5;
    let mut stamps: Vec<i64> = (0..200).map(|frame| frame * PERIOD_NS).collect();
    let whole = run(&mut Choice::new(needs, Some(taken)), &stamps, 1.0, taken);
    // The second frame of the third context.
    let lost = stamps
        .iter()
        .position(|stamp_ns| *stamp_ns == whole.encoded[5].0)
        .unwrap();
    stamps.remove(lost);
    let found = run(&mut Choice::new(needs, Some(taken)), &stamps, 1.0, taken);
    let (before, after) = (whole.contexts(&needs).len(), found.contexts(&needs).len());
    assert!(
        after + 1 >= before && after <= before,
        "{before} and {after}"
    );
}

#[test]
fn a_stamp_that_goes_back_or_was_far_ahead_starves_nobody() {
    let needs = needs(2, 2);
    let mut choice = Choice::new(needs, Some(PERIOD * 5));
    let mut fate = |frame: i64| choice.arrived(frame * PERIOD_NS, Instant::now(), 0);
    assert_eq!(fate(100), Fate::Encode);
    assert_eq!(fate(18_000), Fate::Encode, "a broken stamp");
    assert_eq!(fate(101), Fate::Encode);
    assert_eq!(fate(102), Fate::Skip);
    assert_eq!(fate(0), Fate::Encode, "a bag that begins again");
    assert_eq!(fate(1), Fate::Skip);
    assert_eq!(fate(2), Fate::Encode);
    assert_eq!(fate(2), Fate::Encode, "by the other transport");
}

#[test]
fn modes_are_said_as_people_count_frames() {
    let needs = needs(2, 2);
    let words = |tenths: u32| Mode::of(PERIOD * tenths / 10, &needs).in_words(&needs);
    assert_eq!(words(5), "every frame is used");
    assert_eq!(words(15), "every 2nd frame is used");
    assert_eq!(
        words(55),
        "2 of every 12 frames are used, those of a context, 0.4 s apart"
    );
    let single = Needs {
        context_frames: 1,
        ..needs
    };
    let words = Mode::of(PERIOD * 5, &single).in_words(&single);
    assert_eq!(words, "every 6th frame is used");
}
