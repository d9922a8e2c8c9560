//! What the view knows: pure, told of messages with the time of their arrival, from live topics or from a bag.

use crate::report::pairing::{Awaited, Pairing, Pairings};
use crate::{
    album::{Album, SPAN_NS},
    event::Event,
    journal::{Journal, Limits},
    picture::{Label, Picture, Source},
    rate::Rate,
    scene::Scene,
    status::{Executor, Nodes},
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
        Action, ActionCandidates, ActionChunk, Assessment, ExecutorStatus, Goal, Plan, Prediction,
        PredictionError,
    },
};
use wm_ros::Log;

/// What is heard. The order is that of the page's table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Topic {
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
    Candidates,
    CandidatePictures,
    Assessment,
    Executor,
    Diagnostics,
    Log,
}

impl Topic {
    /// The topic of pictures of this source.
    pub const fn of(source: Source) -> Self {
        match source {
            Source::Camera => Self::Camera,
            Source::Predicted => Self::Pictures,
            Source::Plan => Self::Outcome,
            Source::Candidates => Self::CandidatePictures,
            Source::Goal => Self::Goal,
        }
    }
}

/// Steps of a rollout that are distinguished, as in the report.
const STEP_LIMIT: u32 = 64;
/// Actions are shown at most so often: a robot's may come at 500 Hz \[ns\].
const ACTION_GAP_NS: i64 = 15_000_000;
/// Offers of candidates that can still be chosen from.
const MAX_OFFERS: usize = 8;
/// Actions of an offer that is kept, over all candidates: each is some 100 bytes.
const MAX_OFFERED: usize = 16_384;
/// Events of a live minute: some 15,000 at a camera of 30 Hz.
const LIVE_BYTES: usize = 8 << 20;
/// Events of a bag: an hour at 5 Hz.
const BAG_BYTES: usize = 64 << 20;

/// Why a message is dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum DropReason {
    /// A predicted picture of which it cannot be told of which prediction it is.
    Unpaired,
    /// A prediction whose step or period is out of bounds.
    BadPrediction,
    /// More candidates than are kept.
    LargeOffer,
    /// A transform that is none, that is older than the last one, or of one frame too many.
    BadTransform,
    /// A fit that does not exist.
    BadFit,
}

impl DropReason {
    /// As it is counted in the diagnostics.
    pub const fn reason(self) -> &'static str {
        match self {
            Self::Unpaired => "unpaired_picture",
            Self::BadPrediction => "bad_prediction",
            Self::LargeOffer => "large_offer",
            Self::BadTransform => "bad_transform",
            Self::BadFit => "bad_fit",
        }
    }

    /// In words.
    pub const fn text(self) -> &'static str {
        match self {
            Self::Unpaired => {
                "a predicted picture came so late that nobody can tell of which prediction it is"
            }
            Self::BadPrediction => {
                "a prediction whose step is not 1 to 64, or whose step period is not positive"
            }
            Self::LargeOffer => "candidates with more actions than are kept",
            Self::BadTransform => {
                "a transform that is none, or older than the last one of its frame"
            }
            Self::BadFit => "the decoder's fit is not stretch, crop or pad",
        }
    }
}

/// What the view knows.
#[derive(Debug)]
pub struct State {
    /// Pictures; empty where they are read from a bag.
    pub album: Album,
    /// Events.
    pub journal: Journal,
    /// The nodes' diagnostics.
    pub nodes: Nodes,
    /// What the executor does.
    pub executor: Option<Executor>,
    /// How the camera sees, and where it is.
    pub scene: Scene,
    /// How the model takes the camera's pictures; stretched until the decoder says otherwise.
    pub fit: Fit,
    rates: BTreeMap<Topic, Rate>,
    pairings: Pairings,
    offers: VecDeque<Arc<ActionCandidates>>,
    last_frame_ns: Option<i64>,
    last_action_ns: Option<i64>,
}

impl State {
    /// Of live topics: the last minute, and at most `bytes` of pictures.
    pub fn live(bytes: usize) -> Self {
        Self::new(
            bytes,
            Limits {
                span_ns: SPAN_NS,
                bytes: LIVE_BYTES,
            },
        )
    }

    /// Of a bag: all of it, without the pictures.
    pub fn of_bag() -> Self {
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
            scene: Scene::default(),
            fit: Fit::default(),
            rates: BTreeMap::new(),
            pairings: Pairings::default(),
            offers: VecDeque::new(),
            last_frame_ns: None,
            last_action_ns: None,
        }
    }

    /// Something came on a topic.
    pub fn heard(&mut self, topic: Topic, now_ns: i64) {
        self.rates.entry(topic).or_default().arrived(now_ns);
    }

    /// How often messages came on a topic.
    pub fn rate(&mut self, topic: Topic) -> &mut Rate {
        self.rates.entry(topic).or_default()
    }

    /// Which picture it is that came with this stamp; none where it came before by the other transport, or where nobody can
    /// tell.
    ///
    /// # Errors
    /// Why it is left out, where that is worth counting.
    pub fn label(
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
                    // STEP_LIMIT holds it below 65.
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
            Source::Plan | Source::Candidates | Source::Goal => {
                Ok(Some(Label::of(source, stamp_ns)))
            }
        }
    }

    /// Takes a picture whose label it gave.
    pub fn picture(&mut self, picture: Arc<Picture>, now_ns: i64) {
        self.seen(&picture.label, now_ns);
        if picture.label.source == Source::Camera {
            self.scene.picture(picture.size);
        }
        self.album.add(picture, now_ns);
    }

    /// Tells of a picture that somebody else keeps.
    pub fn seen(&mut self, label: &Label, now_ns: i64) {
        self.journal.add(&Event::picture(label), now_ns);
    }

    /// A predicted step.
    ///
    /// # Errors
    /// Its step or period is out of bounds, or a time is invalid.
    pub fn prediction(&mut self, prediction: &Prediction, now_ns: i64) -> Result<(), DropReason> {
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

    /// A prediction's error.
    pub fn error(&mut self, error: &PredictionError, now_ns: i64) {
        self.heard(Topic::Errors, now_ns);
        if (1..=STEP_LIMIT).contains(&error.step) {
            self.journal.add(&Event::error(error), now_ns);
        }
    }

    /// An action of the robot.
    pub fn action(&mut self, action: &Action, now_ns: i64) {
        self.heard(Topic::Action, now_ns);
        let is_soon = |last_ns: i64| (0..ACTION_GAP_NS).contains(&now_ns.saturating_sub(last_ns));
        if !self.last_action_ns.is_some_and(is_soon) {
            self.last_action_ns = Some(now_ns);
            self.journal.add(&Event::action(action), now_ns);
        }
    }

    /// A policy's next actions.
    pub fn chunk(&mut self, chunk: &ActionChunk, now_ns: i64) {
        self.heard(Topic::Chunk, now_ns);
        self.journal.add(&Event::chunk(chunk), now_ns);
    }

    /// A plan.
    pub fn plan(&mut self, plan: &Plan, now_ns: i64) {
        self.heard(Topic::Plan, now_ns);
        self.journal.add(&Event::plan(plan), now_ns);
    }

    /// Shapes, a plan among them.
    pub fn markers(&mut self, markers: &MarkerArray, now_ns: i64) {
        self.heard(Topic::Markers, now_ns);
        if let Some(way) = self.scene.way(markers) {
            self.journal.add(&Event::way(way), now_ns);
        }
    }

    /// How the model takes the camera's pictures.
    ///
    /// # Errors
    /// There is no such fit.
    pub fn fit(&mut self, fit: &Text) -> Result<(), DropReason> {
        self.fit = fit.data.parse().map_err(|_| DropReason::BadFit)?;
        Ok(())
    }

    /// A goal.
    pub fn goal(&mut self, goal: &Goal, now_ns: i64) {
        self.heard(Topic::Goal, now_ns);
        self.journal.add(&Event::goal(goal), now_ns);
    }

    /// A policy's candidates.
    ///
    /// # Errors
    /// They are more than are kept.
    pub fn candidates(
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

    /// The chunk of a candidate that was offered.
    pub fn offered(&self, stamp_ns: i64, index: usize) -> Option<&ActionChunk> {
        let is_it = |offer: &&Arc<ActionCandidates>| offer.header.stamp.to_nanos() == stamp_ns;
        let offer = self.offers.iter().rev().find(is_it)?;
        offer.chunks.get(index)
    }

    /// What the candidates would do.
    pub fn assessment(&mut self, assessment: &Assessment, now_ns: i64) {
        self.heard(Topic::Assessment, now_ns);
        self.journal.add(&Event::assessment(assessment), now_ns);
    }

    /// What the executor does.
    pub fn executor(&mut self, status: &ExecutorStatus, now_ns: i64) {
        self.heard(Topic::Executor, now_ns);
        self.executor = Some(Executor::of(status, now_ns));
    }

    /// How the nodes are.
    pub fn diagnostics(&mut self, array: &DiagnosticArray, now_ns: i64) {
        self.heard(Topic::Diagnostics, now_ns);
        self.nodes.update(array, now_ns);
    }

    /// A record of the log.
    pub fn log(&mut self, log: &Log, now_ns: i64) {
        self.heard(Topic::Log, now_ns);
        self.journal.add(&Event::log(log), now_ns);
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::picture::tests::{header, picture};
    use wm_msgs::builtin_interfaces::Duration;

    pub const STEP_NS: i64 = 400_000_000;

    pub fn prediction(observed_ns: i64, step: u32) -> Prediction {
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
    fn a_predicted_picture_is_told_by_its_rollout_and_step() {
        let mut state = State::live(1 << 20);
        for observed in [0, STEP_NS] {
            for step in 1..=3 {
                state
                    .prediction(&prediction(observed, step), observed + 60_000_000)
                    .unwrap();
            }
        }
        // 2 steps ahead of the second observation, and 3 of the first, are of one moment: the newer counts.
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
    fn a_frame_that_comes_by_both_transports_counts_once() {
        let mut state = State::live(1 << 20);
        assert!(state.label(Source::Camera, 5, 6).unwrap().is_some());
        assert_eq!(state.label(Source::Camera, 5, 7), Ok(None));
        assert!(state.label(Source::Camera, 9, 10).unwrap().is_some());
    }

    #[test]
    fn what_is_out_of_bounds_is_left_out_by_name() {
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
