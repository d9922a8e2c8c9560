//! A recorded bag instead of live topics. Reads all events; reads pictures on request.

use crate::{
    drop_reason::DropReason,
    picture::{Label, Picture, Source},
    state::{State, Topic},
    status::InputTopic,
};
use anyhow::Result;
use std::{
    collections::{BTreeMap, HashMap},
    path::Path,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};
use tokio::sync::Semaphore;
use wm_bag::{BagError, BagMessage, BagReader};
use wm_camera::{camera_frame::CameraFrame, camera_info::info_topic};
use wm_msgs::{
    diagnostic_msgs::DiagnosticArray,
    sensor_msgs::CameraInfo,
    std_msgs::String as Text,
    tf2_msgs::TFMessage,
    visualization_msgs::MarkerArray,
    wm_msgs::{
        Action, ActionCandidates, ActionChunk, Assessment, ExecutorStatus, Goal, LearnerStatus,
        Plan, Prediction, PredictionError,
    },
};

/// Pictures read at a time: each needs a chunk of the bag in memory.
const READERS: usize = 2;

const TRANSFORMS: &str = "/tf";
const STATIC_TRANSFORMS: &str = "/tf_static";
/// From the suite's namespace.
const FIT: &str = "/wm/predicted/fit";

mod reading;

pub(crate) use reading::read;

pub(crate) struct Bag {
    reader: BagReader,
    topics: BTreeMap<String, Topic>,
    /// The topic of the camera's calibration.
    camera_info: String,
    places: Mutex<HashMap<Label, Place>>,
    readers: Semaphore,
}

/// The position of a picture.
#[derive(Clone, Debug)]
struct Place {
    topic: Arc<str>,
    log_time_ns: u64,
}

/// Why a message is skipped.
#[derive(Debug, thiserror::Error)]
enum Unusable {
    #[error(transparent)]
    Bag(#[from] BagError),
    #[error("{}", .0.text())]
    Dropped(DropReason),
}

impl From<DropReason> for Unusable {
    fn from(reason: DropReason) -> Self {
        Self::Dropped(reason)
    }
}

impl Bag {
    /// Opens the bag at `path`, and finds these topics.
    ///
    /// # Errors
    /// It cannot be read.
    pub(crate) fn open(path: &Path, heard: &[InputTopic]) -> Result<Self, BagError> {
        let reader = BagReader::open(path)?;
        for warning in reader.warnings() {
            tracing::warn!("{warning}");
        }
        let has = |name: &str| {
            reader
                .topic(name)
                .is_some_and(|topic| topic.message_count > 0)
        };
        let mut topics = BTreeMap::new();
        for InputTopic { topic, name, .. } in heard {
            let compressed = format!("{name}/compressed");
            let is_picture = Source::ALL
                .into_iter()
                .any(|source| Topic::of(source) == *topic);
            if is_picture && has(&compressed) {
                topics.insert(compressed, *topic);
            } else {
                topics.insert(name.clone(), *topic);
            }
        }
        let camera = heard.iter().find(|heard| heard.topic == Topic::Camera);
        let camera_info = camera.map(|camera| info_topic(&camera.name));
        // no topic has an empty name
        let camera_info = camera_info.unwrap_or_default();
        // goals of another kind have a topic of their own, which counts as the same
        if let Some((name, _)) = topics.iter().find(|(_, topic)| **topic == Topic::Goal) {
            let name = name
                .trim_end_matches("/compressed")
                .trim_end_matches("/image");
            topics.insert(name.to_owned(), Topic::Goal);
        }
        Ok(Self {
            reader,
            topics,
            camera_info,
            places: Mutex::default(),
            readers: Semaphore::new(READERS),
        })
    }

    pub(crate) fn name(&self) -> String {
        self.reader.path().display().to_string()
    }

    /// no invariant spans the lock
    fn places(&self) -> MutexGuard<'_, HashMap<Label, Place>> {
        self.places.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn apply(&self, state: &mut State, message: &BagMessage) -> Result<(), Unusable> {
        // log times beyond the year 2262 are invalid
        let now_ns = i64::try_from(message.log_time_ns).unwrap_or(i64::MAX);
        let Some(topic) = self.topics.get(&*message.topic) else {
            return self.place(state, message);
        };
        match topic {
            Topic::Camera => self.picture_in(state, Source::Camera, message, now_ns)?,
            Topic::Pictures => self.picture_in(state, Source::Predicted, message, now_ns)?,
            Topic::Outcome => self.picture_in(state, Source::Plan, message, now_ns)?,
            Topic::Subgoals => self.picture_in(state, Source::Subgoals, message, now_ns)?,
            Topic::CandidatePictures => {
                self.picture_in(state, Source::Candidates, message, now_ns)?;
            }
            Topic::Goal if message.topic.contains("/image") => {
                self.picture_in(state, Source::Goal, message, now_ns)?;
            }
            Topic::Goal => state.goal(&message.decode::<Goal>()?, now_ns),
            Topic::Predicted => state.prediction(&message.decode::<Prediction>()?, now_ns)?,
            Topic::Errors => state.error(&message.decode::<PredictionError>()?, now_ns),
            Topic::Action => state.action(&message.decode::<Action>()?, now_ns),
            Topic::Chunk => state.chunk(&message.decode::<ActionChunk>()?, now_ns),
            Topic::Markers => state.markers(&message.decode::<MarkerArray>()?, now_ns),
            Topic::Plan => state.plan(&message.decode::<Plan>()?, now_ns),
            Topic::Candidates => {
                state.candidates(Arc::new(message.decode::<ActionCandidates>()?), now_ns)?;
            }
            Topic::Assessment => state.assessment(&message.decode::<Assessment>()?, now_ns),
            Topic::Executor => state.executor(&message.decode::<ExecutorStatus>()?, now_ns),
            Topic::Learner => state.learner(&message.decode::<LearnerStatus>()?, now_ns),
            Topic::Diagnostics => state.diagnostics(&message.decode::<DiagnosticArray>()?, now_ns),
            Topic::Log => state.log(&message.decode::<wm_ros::Log>()?, now_ns),
        }
        Ok(())
    }

    /// Takes messages about positions in the picture.
    fn place(&self, state: &mut State, message: &BagMessage) -> Result<(), Unusable> {
        let scene = &mut state.scene;
        match &*message.topic {
            FIT => state.fit(&message.decode::<Text>()?)?,
            TRANSFORMS => scene.transforms(&message.decode::<TFMessage>()?, false)?,
            STATIC_TRANSFORMS => scene.transforms(&message.decode::<TFMessage>()?, true)?,
            _ => scene.camera(&message.decode::<CameraInfo>()?),
        }
        Ok(())
    }

    fn picture_in(
        &self,
        state: &mut State,
        source: Source,
        message: &BagMessage,
        now_ns: i64,
    ) -> Result<(), Unusable> {
        let stamp_ns = CameraFrame::of_bag(message)?.header().stamp.to_nanos();
        if let Some(label) = state.label(source, stamp_ns, now_ns)? {
            let place = Place {
                topic: Arc::clone(&message.topic),
                log_time_ns: message.log_time_ns,
            };
            self.places().insert(label, place);
            state.seen(&label, now_ns);
        }
        Ok(())
    }

    /// Reads a picture; `None` if the bag does not have it.
    ///
    /// # Errors
    /// The fault of the bag, as text.
    pub(crate) async fn picture(
        self: Arc<Self>,
        label: Label,
    ) -> Result<Option<Arc<Picture>>, String> {
        let Some(place) = self.places().get(&label).cloned() else {
            return Ok(None);
        };
        let bag = Arc::clone(&self);
        // it is never closed
        let _reading = self
            .readers
            .acquire()
            .await
            .map_err(|error| error.to_string())?;
        let read = tokio::task::spawn_blocking(move || bag.read_picture(label, &place));
        let read = read.await.map_err(|error| error.to_string())?;
        read.map_err(|error| format!("{error:#}"))
    }

    fn read_picture(&self, label: Label, place: &Place) -> Result<Option<Arc<Picture>>> {
        let messages = self.reader.messages().only_topics([&place.topic]);
        for message in messages.starting_at(place.log_time_ns) {
            let message = message?;
            if message.log_time_ns > place.log_time_ns {
                break;
            }
            let frame = CameraFrame::of_bag(&message)?;
            if frame.header().stamp.to_nanos() == label.stamp_ns {
                let now_ns = i64::try_from(message.log_time_ns).unwrap_or(i64::MAX);
                return Ok(Some(Arc::new(Picture::of(&frame, label, now_ns)?)));
            }
        }
        Ok(None)
    }
}
