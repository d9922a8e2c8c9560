//! The start of an episode.

use std::{
    fs::File,
    io::{self, Read as _},
    path::{Path, PathBuf},
    sync::Arc,
    time::Instant,
};

use rustix::fs::{Mode, OFlags};

use wm_bag::BagReader;
use wm_motion::actions::ActionSpace;
use wm_msgs::{
    builtin_interfaces::Time,
    sensor_msgs::CompressedImage,
    std_msgs::String as Text,
    wm_msgs::{Action, EnvResetRequest},
};

use super::{EnvError, EnvModel};
use crate::{
    history::{ChunkMerging, History, HistorySettings, Observation, Reception, Timing, Wait},
    predictor::PredictorError,
};
use wm_camera::{
    camera_frame::CameraFrame,
    goal::camera_topic,
    image_message::{MAX_COMPRESSED, decode_compressed},
};
use wm_ros::PublisherId;

/// Topic of the instruction, in bags and live.
pub(crate) const INSTRUCTION: &str = "/task/instruction";
const ACTION: &str = "/wm/action";
const NANOS: f64 = 1e9;

/// The source of the first frame.
#[derive(Clone, Debug)]
pub enum Start {
    /// A bag, this many seconds after its first camera frame, with the history before it.
    Bag {
        /// Folder or `.mcap`.
        path: PathBuf,
        /// From the bag's start \[s\].
        offset_s: f64,
    },
    /// A file.
    Image(PathBuf),
    /// The next image of a topic.
    Topic(String),
    /// An image that has arrived.
    Frame(Box<CameraFrame>),
}

impl Start {
    /// The start that a request names; `None` if it names none.
    ///
    /// # Errors
    /// [`EnvError::Starts`] where it asks for several, [`EnvError::Offset`].
    pub fn of(request: &EnvResetRequest) -> Result<Option<Self>, EnvError> {
        let asked = [&request.bag, &request.image, &request.topic];
        match asked.map(String::is_empty) {
            [true, true, true] => Ok(None),
            [false, true, true] if request.bag_offset >= 0.0 && request.bag_offset.is_finite() => {
                Ok(Some(Self::Bag {
                    path: request.bag.clone().into(),
                    offset_s: request.bag_offset,
                }))
            }
            [false, true, true] => Err(EnvError::Offset(request.bag_offset)),
            [true, false, true] => Ok(Some(Self::Image(request.image.clone().into()))),
            [true, true, false] => Ok(Some(Self::Topic(request.topic.clone()))),
            empty => Err(EnvError::Starts(
                empty.iter().filter(|is_empty| !**is_empty).count(),
            )),
        }
    }
}

/// The frames and actions at the start of an episode.
#[derive(Debug)]
pub(super) struct Opening {
    /// Latents one model step apart, oldest first.
    pub frames: Vec<Arc<[f32]>>,
    /// The model actions between them.
    pub actions: Vec<Vec<f32>>,
    /// The camera's optical frame.
    pub frame_id: String,
    /// The bag's instruction.
    pub instruction: Option<String>,
}

/// Reads and encodes what `start` names, with a history of `context_frames`.
pub(super) fn open(
    start: &Start,
    world: &EnvModel,
    timing: Timing,
    context_frames: usize,
) -> Result<Opening, EnvError> {
    let frame = match start {
        Start::Bag { path, offset_s } => {
            let reader = BagReader::open(path)?;
            return open_bag(&reader, *offset_s, world, timing, context_frames);
        }
        Start::Image(path) => CameraFrame::Compressed(read_image(path)?),
        Start::Frame(frame) => (**frame).clone(),
        // The node waits for its image first.
        Start::Topic(topic) => {
            return Err(EnvError::Silent {
                topic: topic.clone(),
                seconds: 0.0,
            });
        }
    };
    let latent = world.see(&frame.decode()?)?;
    still(latent, &frame.header().frame_id, world, context_frames)
}

/// Repeats the only known frame, as if the robot had stood still.
fn still(
    latent: Arc<[f32]>,
    frame_id: &str,
    world: &EnvModel,
    context_frames: usize,
) -> Result<Opening, EnvError> {
    let frames = context_frames.clamp(1, world.window());
    Ok(Opening {
        actions: vec![world.standing_still()?; frames - 1],
        frames: vec![latent; frames],
        frame_id: frame_id.to_owned(),
        instruction: None,
    })
}

/// Opens a file. A pipe or a device, which may block, is an error.
fn open_regular(path: &Path) -> io::Result<File> {
    let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let file = File::from(rustix::fs::open(path, flags, Mode::empty())?);
    if file.metadata()?.is_file() {
        Ok(file)
    } else {
        Err(io::Error::other("expected a regular file"))
    }
}

fn read_image(path: &Path) -> Result<CompressedImage, EnvError> {
    let failed = |source| EnvError::File {
        path: path.display().to_string(),
        source,
    };
    let mut data = Vec::new();
    // One byte above the limit, so that a longer file is refused, not cut.
    let limit = MAX_COMPRESSED as u64 + 1;
    open_regular(path)
        .and_then(|file| file.take(limit).read_to_end(&mut data))
        .map_err(failed)?;
    let format = if data.starts_with(b"\x89PNG") {
        "png"
    } else {
        "jpeg"
    };
    let image = CompressedImage {
        format: format.into(),
        data,
        ..CompressedImage::default()
    };
    decode_compressed(&image)?;
    Ok(image)
}

fn open_bag(
    reader: &BagReader,
    offset_s: f64,
    world: &EnvModel,
    timing: Timing,
    context_frames: usize,
) -> Result<Opening, EnvError> {
    let predictor = world.predictor();
    let bag = reader.path().display().to_string();
    // A bag that a recorder wrote does not say what its actions are.
    if let Some(note) = reader.note(ActionSpace::NOTE) {
        let (model, others) = (format!("model {}", predictor.name), format!("bag {bag}"));
        ActionSpace::of_note(Some(note))
            .and_then(|space| {
                predictor
                    .encoding
                    .space()
                    .expect_same(&space, &model, &others)
            })
            .map_err(EnvError::Actions)?;
    }
    let camera = camera_topic(reader, "")?;
    let instruction = match reader.messages().only_topics([INSTRUCTION]).next() {
        Some(message) => Some(message?.decode::<Text>()?.data),
        None => None,
    };
    // Offsets are checked to be finite and positive; a cast saturates.
    let wanted_ns = reader.start_ns().saturating_add((offset_s * NANOS) as u64);
    let history_ns = timing.step_ns().saturating_mul(context_frames as i64);
    // A step is positive.
    let from_ns = wanted_ns.saturating_sub(u64::try_from(history_ns).unwrap_or(0));
    let settings = HistorySettings {
        timing,
        context_frames,
        merging: ChunkMerging::default(),
    };
    // The bag's time is the only one.
    let clock = Time::default();
    let mut history = History::new(
        settings,
        predictor.space.clone(),
        predictor.encoding.clone(),
        clock,
    );
    let reception = Reception {
        stamp: clock,
        clock_step_ns: 0,
        at: Instant::now(),
        publisher: PublisherId::default(),
    };
    // Stamps and images of the history: at most a few model steps at the camera's rate.
    let mut frames: Vec<CameraFrame> = Vec::new();
    let mut first = None;
    for message in reader
        .messages()
        .only_topics([&*camera, ACTION])
        .starting_at(from_ns)
    {
        let message = message?;
        if &*message.topic == ACTION {
            let action: Action = message.decode()?;
            history
                .action(&action, clock)
                .map_err(PredictorError::from)?;
            continue;
        }
        let frame = CameraFrame::of_bag(&message)?;
        if message.log_time_ns >= wanted_ns {
            first = Some(frame);
            break;
        }
        frames.push(frame);
    }
    let Some(first) = first else {
        return Err(EnvError::NoFrame { bag, offset_s });
    };
    // Only the frames of the context are worth encoding.
    let first_ns = first.header().stamp.to_nanos();
    let is_wanted = |frame: &CameraFrame| {
        let before_ns = first_ns - frame.header().stamp.to_nanos();
        let step_ns = timing.step_ns().max(1);
        let steps = (before_ns + step_ns / 2) / step_ns;
        steps >= 1 && (before_ns - steps * step_ns).abs() <= timing.tolerance_ns
    };
    frames.retain(is_wanted);
    let mut newest = None;
    for frame in frames.iter().chain([&first]) {
        let latent = world.see(&frame.decode()?)?;
        let header = frame.header();
        newest = Some(Arc::clone(&latent));
        let observation = Observation {
            header,
            values: latent,
            epoch: 0,
            // The episode is imagined from there: no arm acts on it.
            is_frozen: false,
        };
        history
            .observe(observation, reception)
            .map_err(PredictorError::from)?;
    }
    let mut opening = match (history.moment(), newest) {
        (Ok(moment), _) => Opening {
            frames: (moment.earlier.iter().chain([&moment.observed]))
                .map(|frame| Arc::clone(&frame.values))
                .collect(),
            actions: moment
                .past
                .into_iter()
                .map(|step| step.model.values)
                .collect(),
            frame_id: first.header().frame_id.clone(),
            instruction: None,
        },
        // The bag begins here, or has a gap, or no actions.
        (Err(wait), Some(latent)) => {
            if !matches!(wait, Wait::Context { .. }) {
                tracing::warn!("the episode starts as if the robot had not moved before: {wait}");
            }
            still(latent, &first.header().frame_id, world, context_frames)?
        }
        (Err(_), None) => {
            return Err(EnvError::NoFrame {
                bag: reader.path().display().to_string(),
                offset_s,
            });
        }
    };
    opening.instruction = instruction;
    Ok(opening)
}
