//! The view's state: pure, updated by messages with their times of arrival, from live topics or a bag.

use crate::report::pairing::{Awaited, Pairing, Pairings};
use crate::{
    album::{Album, SPAN_NS},
    diagnostics::Nodes,
    drop_reason::DropReason,
    event::Event,
    executor::Executor,
    journal::{Journal, Limits},
    learner::Learner,
    picture::{Label, Picture, Source},
    rate::Rate,
    scene::Scene,
};
use std::{
    collections::{BTreeMap, VecDeque},
    sync::Arc,
};
use wm_model::Fit;
use wm_msgs::{
    builtin_interfaces::Time,
    diagnostic_msgs::DiagnosticArray,
    std_msgs::String as Text,
    visualization_msgs::MarkerArray,
    wm_msgs::{
        Action, ActionCandidates, ActionChunk, Assessment, ExecutorStatus, Goal, LearnerStatus,
        Plan, Prediction, PredictionError,
    },
};
use wm_ros::Log;

/// A subscribed topic, in the order of the page's table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Topic {
    Camera,
    Predicted,
    Pictures,
    Errors,
    Action,
    Chunk,
    Goal,
    Plan,
    Markers,
    Outcome,
    Subgoals,
    Candidates,
    CandidatePictures,
    Assessment,
    Executor,
    Learner,
    Diagnostics,
    Log,
}

impl Topic {
    /// The topic of pictures of this source.
    pub(crate) const fn of(source: Source) -> Self {
        match source {
            Source::Camera => Self::Camera,
            Source::Predicted => Self::Pictures,
            Source::Plan => Self::Outcome,
            Source::Candidates => Self::CandidatePictures,
            Source::Goal => Self::Goal,
            Source::Subgoals => Self::Subgoals,
        }
    }
}

/// The most steps of a rollout, as in the report.
const STEP_LIMIT: u32 = 64;
/// The shortest time between shown actions: a robot's may arrive at 500 Hz \[ns\].
const ACTION_GAP_NS: i64 = 15_000_000;
/// The last offers of candidates that clients can choose from.
const MAX_OFFERS: usize = 8;
/// The most actions of an offer, over all candidates: each has some 100 bytes.
const MAX_OFFERED: usize = 16_384;
/// Events of a live minute: about 15,000 with a camera of 30 Hz.
const LIVE_BYTES: usize = 8 << 20;
/// Events of a bag: an hour at 5 Hz.
const BAG_BYTES: usize = 64 << 20;

#[derive(Debug)]
pub(crate) struct State {
    /// Empty if pictures are read from a bag.
    pub album: Album,
    pub journal: Journal,
    /// The nodes' diagnostics.
    pub nodes: Nodes,
    pub executor: Option<Executor>,
    pub learner: Option<Learner>,
    pub scene: Scene,
    /// How the model frames the camera's pictures; stretched until the decoder publishes it.
    pub fit: Fit,
    rates: BTreeMap<Topic, Rate>,
    pairings: Pairings,
    offers: VecDeque<Arc<ActionCandidates>>,
    last_frame_ns: Option<i64>,
    last_action_ns: Option<i64>,
}

impl State {
    /// For live topics: the last minute, and at most `bytes` of pictures.
    pub(crate) fn live(bytes: usize) -> Self {
        Self::new(
            bytes,
            Limits {
                span_ns: SPAN_NS,
                bytes: LIVE_BYTES,
            },
        )
    }

    /// For a bag: all events, without pictures.
    pub(crate) fn of_bag() -> Self {
        Self::new(
            0,
            Limits {
                span_ns: i64::MAX,
                bytes: BAG_BYTES,
            },
        )
    }

    fn new(bytes: usize, limits: Limits) -> Self {
        Self {
            album: Album::new(bytes),
            journal: Journal::new(limits),
            nodes: Nodes::default(),
            executor: None,
            learner: None,
            scene: Scene::default(),
            fit: Fit::default(),
            rates: BTreeMap::new(),
            pairings: Pairings::default(),
            offers: VecDeque::new(),
            last_frame_ns: None,
            last_action_ns: None,
        }
    }

    /// Counts a message of a topic.
    pub(crate) fn heard(&mut self, topic: Topic, now_ns: i64) {
        self.rates.entry(topic).or_default().arrived(now_ns);
    }

    /// The rate of messages on a topic.
    pub(crate) fn rate(&mut self, topic: Topic) -> &mut Rate {
        self.rates.entry(topic).or_default()
    }

    /// The label of a picture with this stamp. `None` if it arrived before by the other transport, or its prediction is
    /// unknown.
    ///
    /// # Errors
    /// Why it is dropped, if that counts as a loss.
    pub(crate) fn label(
        &mut self,
        source: Source,
        stamp_ns: i64,
        now_ns: i64,
    ) -> Result<Option<Label>, DropReason> {
        self.heard(Topic::of(source), now_ns);
        match source {
            Source::Predicted => match self.pairings.pictured(stamp_ns, now_ns) {
                Pairing::Found(awaited) => Ok(Some(Label {
                    source,
                    // STEP_LIMIT keeps it below 65
                    step: awaited.step as u8,
                    stamp_ns,
                    observed_ns: awaited.observed_ns,
                })),
                Pairing::Late => Err(DropReason::Unpaired),
                // Of a rollout that was under way when the view began, or that came raw too.
                Pairing::Unknown => Ok(None),
            },
            Source::Camera if self.last_frame_ns == Some(stamp_ns) => Ok(None),
            Source::Camera => {
                self.last_frame_ns = Some(stamp_ns);
                Ok(Some(Label::of(source, stamp_ns)))
            }
            Source::Plan | Source::Candidates | Source::Goal | Source::Subgoals => {
                Ok(Some(Label::of(source, stamp_ns)))
            }
        }
    }

    /// Adds a labelled picture.
    pub(crate) fn picture(&mut self, picture: Arc<Picture>, now_ns: i64) {
        self.seen(&picture.label, now_ns);
        if picture.label.source == Source::Camera {
            self.scene.picture(picture.size);
        }
        self.album.add(picture, now_ns);
    }

    /// Records a picture that the bag holds.
    pub(crate) fn seen(&mut self, label: &Label, now_ns: i64) {
        self.journal.add(&Event::picture(label), now_ns);
    }

    /// A predicted step.
    ///
    /// # Errors
    /// Its step or period is out of bounds, or a time is invalid.
    pub(crate) fn prediction(
        &mut self,
        prediction: &Prediction,
        now_ns: i64,
    ) -> Result<(), DropReason> {
        self.heard(Topic::Predicted, now_ns);
        // A message of a node of this process was not decoded.
        let nanos = |stamp: Time| stamp.checked_nanos().map_err(|_| DropReason::BadPrediction);
        let period_ns = prediction.step_period.checked_nanos().unwrap_or(0);
        if prediction.step == 0 || prediction.step > STEP_LIMIT || period_ns <= 0 {
            return Err(DropReason::BadPrediction);
        }
        nanos(prediction.ready_stamp)?;
        self.pairings.predicted(Awaited {
            stamp_ns: nanos(prediction.header.stamp)?,
            observed_ns: nanos(prediction.observed_stamp)?,
            step: prediction.step,
            period_ns,
            arrived_ns: now_ns,
        });
        if prediction.step == 1 || prediction.step == prediction.horizon {
            self.journal.add(&Event::prediction(prediction), now_ns);
        }
        Ok(())
    }

    pub(crate) fn error(&mut self, error: &PredictionError, now_ns: i64) {
        self.heard(Topic::Errors, now_ns);
        if (1..=STEP_LIMIT).contains(&error.step) {
            self.journal.add(&Event::error(error), now_ns);
        }
    }

    pub(crate) fn action(&mut self, action: &Action, now_ns: i64) {
        self.heard(Topic::Action, now_ns);
        let is_soon = |last_ns: i64| (0..ACTION_GAP_NS).contains(&now_ns.saturating_sub(last_ns));
        if !self.last_action_ns.is_some_and(is_soon) {
            self.last_action_ns = Some(now_ns);
            self.journal.add(&Event::action(action), now_ns);
        }
    }

    /// A policy's next actions.
    pub(crate) fn chunk(&mut self, chunk: &ActionChunk, now_ns: i64) {
        self.heard(Topic::Chunk, now_ns);
        self.journal.add(&Event::chunk(chunk), now_ns);
    }

    pub(crate) fn plan(&mut self, plan: &Plan, now_ns: i64) {
        self.heard(Topic::Plan, now_ns);
        self.journal.add(&Event::plan(plan), now_ns);
    }

    /// Markers, among them a plan's path.
    pub(crate) fn markers(&mut self, markers: &MarkerArray, now_ns: i64) {
        self.heard(Topic::Markers, now_ns);
        if let Some(way) = self.scene.way(markers) {
            self.journal.add(&Event::way(way), now_ns);
        }
    }

    /// How the model frames the camera's pictures.
    ///
    /// # Errors
    /// There is no such fit.
    pub(crate) fn fit(&mut self, fit: &Text) -> Result<(), DropReason> {
        self.fit = fit.data.parse().map_err(|_| DropReason::BadFit)?;
        Ok(())
    }

    pub(crate) fn goal(&mut self, goal: &Goal, now_ns: i64) {
        self.heard(Topic::Goal, now_ns);
        self.journal.add(&Event::goal(goal), now_ns);
    }

    /// A policy's candidates.
    ///
    /// # Errors
    /// They have too many actions.
    pub(crate) fn candidates(
        &mut self,
        candidates: Arc<ActionCandidates>,
        now_ns: i64,
    ) -> Result<(), DropReason> {
        self.heard(Topic::Candidates, now_ns);
        let chunks = candidates.chunks.iter();
        if chunks.map(|chunk| chunk.actions.len()).sum::<usize>() > MAX_OFFERED {
            return Err(DropReason::LargeOffer);
        }
        self.journal.add(&Event::candidates(&candidates), now_ns);
        if self.offers.len() == MAX_OFFERS {
            self.offers.pop_front();
        }
        self.offers.push_back(candidates);
        Ok(())
    }

    /// The chunk of an offered candidate.
    pub(crate) fn offered(&self, stamp_ns: i64, index: usize) -> Option<&ActionChunk> {
        let is_it = |offer: &&Arc<ActionCandidates>| offer.header.stamp.to_nanos() == stamp_ns;
        let offer = self.offers.iter().rev().find(is_it)?;
        offer.chunks.get(index)
    }

    /// The predicted outcomes of the candidates.
    pub(crate) fn assessment(&mut self, assessment: &Assessment, now_ns: i64) {
        self.heard(Topic::Assessment, now_ns);
        self.journal.add(&Event::assessment(assessment), now_ns);
    }

    pub(crate) fn executor(&mut self, status: &ExecutorStatus, now_ns: i64) {
        self.heard(Topic::Executor, now_ns);
        self.executor = Some(Executor::of(status, now_ns));
    }

    pub(crate) fn learner(&mut self, status: &LearnerStatus, now_ns: i64) {
        self.heard(Topic::Learner, now_ns);
        self.learner = Some(Learner::of(status));
    }

    pub(crate) fn diagnostics(&mut self, array: &DiagnosticArray, now_ns: i64) {
        self.heard(Topic::Diagnostics, now_ns);
        self.nodes.update(array, now_ns);
    }

    pub(crate) fn log(&mut self, log: &Log, now_ns: i64) {
        self.heard(Topic::Log, now_ns);
        self.journal.add(&Event::log(log), now_ns);
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::picture::tests::{header, picture};
    use wm_msgs::builtin_interfaces::Duration;

    pub(crate) const STEP_NS: i64 = 400_000_000;

    pub(crate) fn prediction(observed_ns: i64, step: u32) -> Prediction {
        Prediction {
            header: header(observed_ns + i64::from(step) * STEP_NS),
            observed_stamp: Time::from_nanos(observed_ns),
            ready_stamp: Time::from_nanos(observed_ns + 55_000_000),
            step,
            horizon: 3,
            step_period: Duration::from_nanos(STEP_NS),
            ..Prediction::default()
        }
    }

    #[test]
    fn predicted_picture_is_identified_by_rollout_and_step() {
        let mut state = State::live(1 << 20);
        for observed in [0, STEP_NS] {
            for step in 1..=3 {
                state
                    .prediction(&prediction(observed, step), observed + 60_000_000)
                    .unwrap();
            }
        }
        // 2 steps after the second observation, and 3 after the first, are the same time: the newer counts
        let label = state.label(Source::Predicted, 3 * STEP_NS, STEP_NS + 90_000_000);
        let expected = Label {
            source: Source::Predicted,
            step: 2,
            stamp_ns: 3 * STEP_NS,
            observed_ns: STEP_NS,
        };
        assert_eq!(label, Ok(Some(expected)));
        state.picture(Arc::new(picture(expected)), STEP_NS + 90_000_000);
        assert!(state.album.find(&expected).is_some());
        assert_eq!(state.label(Source::Predicted, 17, 18), Ok(None));
        let late = state.label(Source::Predicted, STEP_NS, 9 * STEP_NS);
        assert_eq!(late, Err(DropReason::Unpaired));
    }

    #[test]
    fn frame_on_both_transports_counts_once() {
        let mut state = State::live(1 << 20);
        assert!(state.label(Source::Camera, 5, 6).unwrap().is_some());
        assert_eq!(state.label(Source::Camera, 5, 7), Ok(None));
        assert!(state.label(Source::Camera, 9, 10).unwrap().is_some());
    }

    #[test]
    fn out_of_bounds_values_are_dropped_by_name() {
        let mut state = State::live(1 << 20);
        for bad in [
            Prediction {
                step: 0,
                ..prediction(0, 1)
            },
            Prediction {
                step: 65,
                ..prediction(0, 1)
            },
            Prediction {
                step_period: Duration::from_nanos(-1),
                ..prediction(0, 1)
            },
            Prediction {
                step_period: Duration {
                    sec: 0,
                    nanosec: 1_000_000_000,
                },
                ..prediction(0, 1)
            },
            Prediction {
                observed_stamp: Time {
                    sec: 1,
                    nanosec: 1_000_000_000,
                },
                ..prediction(0, 1)
            },
        ] {
            assert_eq!(state.prediction(&bad, 1), Err(DropReason::BadPrediction));
        }
        let chunk = ActionChunk {
            actions: vec![Action::default(); MAX_OFFERED],
            ..ActionChunk::default()
        };
        let offer = |number| {
            Arc::new(ActionCandidates {
                header: header(7),
                chunks: vec![chunk.clone(); number],
                ..ActionCandidates::default()
            })
        };
        assert_eq!(state.candidates(offer(2), 1), Err(DropReason::LargeOffer));
        assert_eq!(state.candidates(offer(1), 1), Ok(()));
        assert!(state.offered(7, 0).is_some() && state.offered(7, 1).is_none());
        assert!(state.offered(8, 0).is_none());
    }

    #[test]
    fn actions_at_a_high_rate_are_thinned_out() {
        let mut state = State::live(1 << 20);
        for number in 0..500 {
            state.action(&Action::default(), number * 2_000_000);
        }
        assert_eq!(state.rate(Topic::Action).count(), 500);
        assert!(state.journal.end() < 70, "{}", state.journal.end());
    }
}
