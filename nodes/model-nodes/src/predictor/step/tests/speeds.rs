//! Camera, encoder and predictor at a virtual clock, with work of any length: the predictions, and the fate of every frame.

use std::{collections::VecDeque, time::Duration as Span};

use super::*;
use crate::{
    cadence::{Cadence, Load, Verdict, periods},
    encoder::{Choice, Fate, Mode, Needs},
};

const FRAME: Span = Span::from_millis(200);
const TICK: Span = Span::from_millis(5);
const NEEDS: Needs = Needs {
    frame_period: FRAME,
    frame_skip: 2,
    context_frames: 2,
};

/// A worker that is busy until some moment, and what it works on.
type Running<T> = Option<(T, Span)>;

/// The fates of frames and rollouts.
#[derive(Debug, Default)]
struct Ledger {
    frames: usize,
    encoded: usize,
    frames_skipped: usize,
    frames_late: usize,
    /// Observations that had a whole context when they came.
    observations: usize,
    observations_skipped: usize,
    observations_late: usize,
    /// Frames that rollouts began from, each with when that was and whether it was the newest with a context.
    rollouts: Vec<(i64, Span, bool)>,
    /// Waits that an operator would have been told of once predictions came.
    waits: usize,
    flushed: usize,
    untimely: u64,
    missed: u64,
}

struct Pipeline {
    predictor: PredictorStep,
    choice: Choice,
    cadence: Cadence,
    encode: Span,
    rollout: Span,
    encoding: Running<i64>,
    to_encode: VecDeque<i64>,
    predicting: Running<i64>,
    to_predict: Option<i64>,
    newest: i64,
    ledger: Ledger,
}

impl Pipeline {
    fn new(encode: Span, rollout: Span) -> Self {
        Self {
            predictor: predictor(),
            choice: Choice::new(NEEDS, Some(encode)),
            // As the node makes it, that does not know of the encoder.
            cadence: Cadence::new(FRAME, Some(rollout)),
            encode,
            rollout,
            encoding: None,
            to_encode: VecDeque::new(),
            predicting: None,
            to_predict: None,
            newest: 0,
            ledger: Ledger::default(),
        }
    }

    fn frame(&mut self, frame: i64, now: Span, begin: Instant) {
        self.ledger.frames += 1;
        let stamp_ns = stamp(frame).to_nanos();
        let fate = self
            .choice
            .arrived(stamp_ns, begin + now, self.to_encode.len());
        match fate {
            Fate::Skip => self.ledger.frames_skipped += 1,
            Fate::Late => self.ledger.frames_late += 1,
            Fate::Encode if self.encoding.is_none() => {
                self.encoding = Some((frame, now + self.encode));
            }
            Fate::Encode => {
                if self.to_encode.len() >= self.choice.room() {
                    self.to_encode.pop_front();
                    self.ledger.frames_late += 1;
                }
                self.to_encode.push_back(frame);
            }
        }
    }

    fn tick(&mut self, now: Span, begin: Instant) {
        if let Some((frame, _)) = self.encoding.filter(|(_, end)| *end <= now) {
            let next = self.to_encode.pop_front();
            self.encoding = next.map(|next| (next, now + self.encode));
            self.choice.took(self.encode);
            self.ledger.encoded += 1;
            self.latent(frame, now, begin);
        }
        if self.predicting.is_some_and(|(_, end)| end <= now) {
            self.predicting = None;
            if let Some(frame) = self.to_predict.take() {
                self.cadence.begun(begin + now);
                self.begin_rollout(frame, now);
            }
            self.cadence.took(self.rollout);
        }
    }

    fn latent(&mut self, frame: i64, now: Span, begin: Instant) {
        let reception = Reception {
            stamp: Time::from_nanos(START + i64::try_from(now.as_nanos()).unwrap()),
            clock_step_ns: 0,
            at: begin + now,
            publisher: PublisherId::default(),
        };
        let outcome = self.predictor.latent(&latent(frame), reception).unwrap();
        let ledger = &mut self.ledger;
        ledger.flushed += usize::from(outcome.arrival.flushed || outcome.arrival.held_back);
        ledger.untimely += outcome.arrival.untimely;
        ledger.missed += outcome.arrival.missed_frames;
        match outcome.rollout {
            None => return,
            Some(Err(_)) => {
                ledger.waits += usize::from(ledger.observations > 0);
                return;
            }
            Some(Ok(request)) => {
                assert_eq!(request.moment.observed.stamp_ns, stamp(frame).to_nanos());
            }
        }
        ledger.observations += 1;
        self.newest = frame;
        let load = match (self.predicting, self.to_predict) {
            (None, _) => Load::Idle,
            (Some(_), None) => Load::Busy,
            (Some(_), Some(_)) => Load::Waiting,
        };
        let verdict = self
            .cadence
            .arrived(stamp(frame).to_nanos(), begin + now, load);
        match verdict {
            Verdict::Skip => ledger.observations_skipped += 1,
            Verdict::Use if load == Load::Idle => self.begin_rollout(frame, now),
            Verdict::Use => self.to_predict = Some(frame),
            Verdict::Replace | Verdict::ReplaceLate => {
                let is_late = verdict == Verdict::ReplaceLate;
                ledger.observations_late += usize::from(is_late);
                ledger.observations_skipped += usize::from(!is_late);
                self.to_predict = Some(frame);
            }
        }
    }

    fn begin_rollout(&mut self, frame: i64, now: Span) {
        self.predicting = Some((frame, now + self.rollout));
        let is_newest = frame == self.newest;
        self.ledger.rollouts.push((frame, now, is_newest));
    }
}

/// The fates of `frames` camera frames.
fn run(encode: Span, rollout: Span, frames: i64) -> Ledger {
    let begin = Instant::now();
    let mut pipeline = Pipeline::new(encode, rollout);
    let mut now = Span::ZERO;
    let mut shown = 0;
    loop {
        if shown < frames && now >= FRAME * u32::try_from(shown).unwrap() {
            let taken = action(shown);
            pipeline.predictor.action(&taken, stamp(shown)).unwrap();
            pipeline.frame(shown, now, begin);
            shown += 1;
        }
        pipeline.tick(now, begin);
        let is_idle = pipeline.encoding.is_none() && pipeline.predicting.is_none();
        if shown == frames && is_idle {
            return pipeline.ledger;
        }
        now += TICK;
    }
}

#[test]
fn at_every_speed_predictions_come_steadily_from_newest_frames() {
    for encode_tenths in [5, 15, 30, 100] {
        for rollout_tenths in [5, 18, 80] {
            let (encode, rollout) = (FRAME * encode_tenths / 10, FRAME * rollout_tenths / 10);
            let contexts = Mode::of(encode, &NEEDS).interval(&NEEDS);
            let nth = periods(rollout, contexts);
            let interval = contexts * nth;
            let expected = 40;
            let frames = periods(interval * expected, FRAME);
            let found = run(encode, rollout, i64::from(frames));
            let case = format!("encoding {encode:?}, rollouts {rollout:?}: {found:?}");

            assert_eq!(
                found.encoded + found.frames_skipped + found.frames_late,
                found.frames,
                "{case}"
            );
            assert_eq!(
                found.rollouts.len() + found.observations_skipped + found.observations_late,
                found.observations,
                "{case}"
            );
            // While n settles some are lost, and no more after that.
            assert!(
                found.frames_late <= 4 && found.observations_late <= 4,
                "{case}"
            );
            let count = found.rollouts.len();
            assert!((34..=44).contains(&count), "{count} of {expected}: {case}");
            let settled = &found.rollouts[count - 20..];
            for (before, after) in settled.iter().zip(&settled[1..]) {
                let gap = FRAME * u32::try_from(after.0 - before.0).unwrap();
                assert_eq!(gap, interval, "{case}");
            }
            assert!(settled.iter().all(|(.., is_newest)| *is_newest), "{case}");
            assert_eq!(
                (found.waits, found.flushed, found.untimely),
                (0, 0, 0),
                "{case}"
            );
            assert!(found.missed <= 4, "{case}");
        }
    }
}
