//! The env's state.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::PathBuf,
    sync::Arc,
};

use image::RgbImage;
use wm_motion::actions::{ActionError, ActionSpace};
use wm_msgs::{
    builtin_interfaces::{Duration, Time},
    sensor_msgs::CompressedImage,
    std_msgs::Header,
    wm_msgs::{Action, EnvResetRequest, EnvResetResponse, Prediction},
};

use super::{
    EnvError, EnvModel, Start,
    episode::Episode,
    model::Row,
    recording::Recording,
    start::{Opening, open},
};
use crate::history::{MAX_CHUNK, Timing};
use wm_camera::image_message::encode_jpeg;
use wm_wire::latent_message::{LatentDtype, encode_latent};

/// Longest name of an episode.
const MAX_NAME: usize = 100;

/// Settings of an env.
#[derive(Clone, Debug)]
pub struct EnvSettings {
    /// Episodes that may be open at once.
    pub max_episodes: usize,
    /// Steps of an episode whose request gives no number.
    pub max_steps: u32,
    /// Frames that an episode starts from, one model step apart.
    pub context_frames: usize,
    /// JPEG quality of observations, 1 to 100.
    pub jpeg_quality: u8,
    /// Instruction if neither request nor bag has one.
    pub instruction: String,
    /// Folder of the episodes' bags; `None`: no bags.
    pub output: Option<PathBuf>,
}

/// An observed or predicted picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Observation {
    /// As a message; its stamp is the episode's time.
    pub jpeg: CompressedImage,
    /// The picture before it was compressed.
    pub picture: RgbImage,
}

/// Actions for one episode.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Move {
    /// The episode.
    pub episode_id: String,
    /// At the camera's rate; a step takes `frame_skip` of them, the last one is held until its step is full.
    pub actions: Vec<Action>,
    /// Whether the episode ends after them.
    pub close: bool,
    /// Whether the task was done, for the bag of an episode that ends.
    pub outcome: Option<bool>,
}

/// The result of a [`Move`].
#[derive(Clone, Debug, PartialEq)]
pub struct Moved {
    /// One per step.
    pub observations: Vec<Observation>,
    /// Steps of the episode so far.
    pub steps: u32,
    /// Whether it takes no more actions.
    pub truncated: bool,
    /// The bag of an episode that was closed.
    pub bag: Option<PathBuf>,
    /// Stamp of the observation before the move.
    pub capture: Time,
    /// Stamp of the newest observation.
    pub stamp: Time,
}

/// An open episode.
struct Session {
    episode: Episode,
    recording: Option<Recording>,
    /// Of the newest observation.
    stamp_ns: i64,
    frame_id: String,
    max_steps: u32,
}

impl Session {
    fn steps(&self) -> u32 {
        // The steps of an episode are limited far below 2^32.
        u32::try_from(self.episode.steps()).unwrap_or(u32::MAX)
    }
}

/// A move under way.
struct Running {
    session: Session,
    /// The camera-rate actions of each step to take, and their model action.
    todo: Vec<(Vec<Action>, Vec<f32>)>,
    observations: Vec<Observation>,
    capture_ns: i64,
    failure: Option<EnvError>,
}

/// Episodes within a world model: resets and moves in, observations out.
pub struct Env {
    world: EnvModel,
    settings: EnvSettings,
    timing: Timing,
    sessions: BTreeMap<String, Session>,
    /// Episodes begun.
    begun: u64,
}

impl Env {
    /// An env without episodes.
    pub fn new(world: EnvModel, settings: EnvSettings, timing: Timing) -> Self {
        Self {
            world,
            settings,
            timing,
            sessions: BTreeMap::new(),
            begun: 0,
        }
    }

    /// Episodes that are open.
    pub fn episodes(&self) -> usize {
        self.sessions.len()
    }

    /// Whether an episode can begin at `start`.
    ///
    /// # Errors
    /// [`EnvError`] says what is wrong with it.
    pub fn check(&self, start: &Start) -> Result<(), EnvError> {
        self.open(start).map(drop)
    }

    fn open(&self, start: &Start) -> Result<Opening, EnvError> {
        let context_frames = self.settings.context_frames;
        open(start, &self.world, self.timing, context_frames)
    }

    /// Begins an episode at `start`, its first observation at `begin`. An open one of the same name is closed.
    ///
    /// # Errors
    /// [`EnvError`] says what is wrong with the request or its start; nothing has begun then.
    pub fn reset(
        &mut self,
        request: &EnvResetRequest,
        start: &Start,
        begin: Time,
    ) -> Result<(EnvResetResponse, Observation), EnvError> {
        let name = match request.episode_id.as_str() {
            "" => self.free_name(),
            name if is_name(name) => name.to_owned(),
            name => return Err(EnvError::Name(name.to_owned())),
        };
        if !self.sessions.contains_key(&name) && self.sessions.len() >= self.settings.max_episodes {
            return Err(EnvError::Full(self.sessions.len()));
        }
        let Opening {
            frames,
            actions,
            frame_id,
            instruction,
        } = self.open(start)?;
        let instruction = if request.instruction.is_empty() {
            instruction.unwrap_or_else(|| self.settings.instruction.clone())
        } else {
            request.instruction.clone()
        };
        let episode = Episode::new(frames, actions, self.world.window(), request.seed);
        let newest = episode.newest().cloned().ok_or(EnvError::NoStart)?;
        let begin_ns = begin.to_nanos();
        let observation = self.observation(&newest, begin_ns, &frame_id)?;
        if let Some(earlier) = self.sessions.remove(&name) {
            finish(earlier, None)?;
        }
        let mut recording = match &self.settings.output {
            Some(folder) => {
                let notes = self.notes(start, request.seed).map_err(EnvError::Actions)?;
                Some(Recording::begin(
                    folder,
                    &name,
                    &instruction,
                    begin,
                    &notes,
                )?)
            }
            None => None,
        };
        if let Some(recording) = &mut recording {
            recording.observation(&observation.jpeg)?;
        }
        self.begun += 1;
        let max_steps = match request.max_steps {
            0 => self.settings.max_steps,
            steps => steps,
        };
        let session = Session {
            episode,
            recording,
            stamp_ns: begin_ns,
            frame_id,
            max_steps,
        };
        self.sessions.insert(name.clone(), session);
        let response = EnvResetResponse {
            success: true,
            message: String::new(),
            episode_id: name,
            instruction,
            step_period: Duration::from_nanos(self.timing.step_ns()),
            // A step holds a handful of frames.
            actions_per_step: self.timing.frame_skip as u32,
            stamp: begin,
        };
        Ok((response, observation))
    }

    /// Makes moves, at most one an episode, side by side: the first step of all of them, then the second of those that
    /// have one, and so on. The answers are in the order of the moves.
    ///
    /// # Errors
    /// Each move has its own; an episode whose move fails stays as it is after the steps before.
    pub fn step(&mut self, moves: &[Move]) -> Vec<Result<Moved, EnvError>> {
        let mut started = BTreeSet::new();
        let mut running: Vec<Result<Running, EnvError>> = moves
            .iter()
            .map(|asked| {
                if started.insert(&asked.episode_id) {
                    self.begin(asked)
                } else {
                    Err(self.unknown(&asked.episode_id))
                }
            })
            .collect();
        let rounds = running
            .iter()
            .flatten()
            .map(|running| running.todo.len())
            .max();
        // Without a valid move there is no round.
        for round in 0..rounds.unwrap_or(0) {
            self.round(round, moves, &mut running);
        }
        let ended = moves.iter().zip(running);
        ended
            .map(|(asked, running)| self.end(asked, running?))
            .collect()
    }

    /// Ends all episodes and their bags; what could not be written.
    pub fn close(&mut self) -> Vec<EnvError> {
        let sessions = std::mem::take(&mut self.sessions).into_values();
        sessions
            .filter_map(|session| finish(session, None).err())
            .collect()
    }

    /// Takes the episode of a move out of the map, with its actions.
    fn begin(&mut self, asked: &Move) -> Result<Running, EnvError> {
        let Some(session) = self.sessions.get(&asked.episode_id) else {
            return Err(self.unknown(&asked.episode_id));
        };
        let count = asked.actions.len();
        if count > MAX_CHUNK || (count == 0 && !asked.close) {
            return Err(EnvError::Count(count));
        }
        let left = session.max_steps.saturating_sub(session.steps());
        if left == 0 && count > 0 {
            return Err(EnvError::Over {
                name: asked.episode_id.clone(),
                steps: session.steps(),
            });
        }
        let space = self.world.predictor().encoding.space();
        for (index, action) in asked.actions.iter().enumerate() {
            let checked = space.check(&action.values);
            checked.map_err(|source| EnvError::Action { index, source })?;
        }
        let skip = self.timing.frame_skip;
        let mut todo = Vec::with_capacity(count.div_ceil(skip));
        for step in asked.actions.chunks(skip) {
            let mut step = step.to_vec();
            if let Some(last) = step.last().cloned() {
                step.resize(skip, last);
            }
            let action = self.world.model_action(&step)?;
            todo.push((step, action));
        }
        todo.truncate(left as usize);
        let Some(session) = self.sessions.remove(&asked.episode_id) else {
            return Err(self.unknown(&asked.episode_id));
        };
        Ok(Running {
            capture_ns: session.stamp_ns,
            session,
            todo,
            observations: Vec::new(),
            failure: None,
        })
    }

    /// One step of every move that has one left.
    fn round(&self, round: usize, moves: &[Move], running: &mut [Result<Running, EnvError>]) {
        let mut active = Vec::new();
        for (asked, running) in moves.iter().zip(running) {
            let Ok(running) = running else { continue };
            let Some((_, action)) = running.todo.get(round) else {
                continue;
            };
            if running.failure.is_some() {
                continue;
            }
            // The newest frame carries the action after it; if none is known, this one continues.
            let next = running.todo.get(round + 1).map_or(action, |(_, next)| next);
            let (action, next) = (action.clone(), next.clone());
            active.push((asked, running, action, next));
        }
        let rows: Vec<_> = active
            .iter()
            .map(|(_, running, action, next)| Row {
                episode: &running.session.episode,
                action,
                next,
            })
            .collect();
        let predicted = self.world.predict(&rows);
        drop(rows);
        match predicted {
            Ok(latents) => {
                for ((asked, running, action, _), latent) in active.into_iter().zip(latents) {
                    let name = &asked.episode_id;
                    if let Err(error) = self.take(name, running, round, action, latent) {
                        running.failure = Some(error);
                    }
                }
            }
            Err(error) => {
                // The batch has failed as a whole, so each of its episodes fails.
                let text = error.to_string();
                for (_, running, _, _) in active {
                    running.failure =
                        Some(wm_model::Error::config("the batch", text.clone()).into());
                }
            }
        }
    }

    /// Records a predicted latent and its picture.
    fn take(
        &self,
        name: &str,
        running: &mut Running,
        round: usize,
        action: Vec<f32>,
        latent: Arc<[f32]>,
    ) -> Result<(), EnvError> {
        let session = &mut running.session;
        let from_ns = session.stamp_ns;
        let stamp_ns = from_ns.saturating_add(self.timing.step_ns());
        let header = Header {
            stamp: Time::from_nanos(stamp_ns),
            frame_id: session.frame_id.clone(),
        };
        let model = self.world.predictor();
        let encoded = encode_latent(&latent, &model.space, LatentDtype::F16, header.clone());
        let encoded = encoded.map_err(|source| EnvError::Prediction {
            name: name.to_owned(),
            step: session.steps().saturating_add(1),
            source,
        })?;
        let observation = self.observation(&latent, stamp_ns, &session.frame_id)?;
        session.episode.push(action, latent);
        session.stamp_ns = stamp_ns;
        if let Some(recording) = &mut session.recording {
            let mut taken = Vec::new();
            let actions = running
                .todo
                .get(round)
                .into_iter()
                .flat_map(|(step, _)| step);
            for (action, slot_ns) in actions.zip(self.timing.slots(from_ns)) {
                let mut action = action.clone();
                action.header.stamp = Time::from_nanos(slot_ns);
                recording.action(&action)?;
                taken.push(action);
            }
            recording.prediction(&Prediction {
                header,
                observed_stamp: Time::from_nanos(from_ns),
                // Each step of an episode is a prediction from the frame before.
                step: 1,
                horizon: 1,
                step_period: Duration::from_nanos(self.timing.step_ns()),
                latent: encoded,
                actions: taken,
                // An episode is one history.
                epoch: 0,
                model: model.name.clone(),
                model_hash: model.hash.clone(),
                seed: session.episode.seed(),
                // At most 1000, by the parameter.
                integration_steps: u32::try_from(self.world.integration_steps())
                    .unwrap_or(u32::MAX),
                received_stamp: Time::from_nanos(from_ns),
                ready_stamp: Time::from_nanos(stamp_ns),
            })?;
            recording.observation(&observation.jpeg)?;
        }
        running.observations.push(observation);
        Ok(())
    }

    /// Puts the episode of a move back, or closes it.
    fn end(&mut self, asked: &Move, running: Running) -> Result<Moved, EnvError> {
        let Running {
            session,
            observations,
            capture_ns,
            failure,
            ..
        } = running;
        let (steps, stamp) = (session.steps(), Time::from_nanos(session.stamp_ns));
        let is_over = steps >= session.max_steps;
        let mut bag = None;
        match &failure {
            None if asked.close => bag = finish(session, asked.outcome)?,
            _ => {
                self.sessions.insert(asked.episode_id.clone(), session);
            }
        }
        match failure {
            Some(error) => Err(error),
            None => Ok(Moved {
                observations,
                steps,
                truncated: is_over || asked.close,
                bag,
                capture: Time::from_nanos(capture_ns),
                stamp,
            }),
        }
    }

    fn observation(
        &self,
        latent: &[f32],
        stamp_ns: i64,
        frame_id: &str,
    ) -> Result<Observation, EnvError> {
        let picture = self.world.picture(latent)?;
        let header = Header {
            stamp: Time::from_nanos(stamp_ns),
            frame_id: frame_id.to_owned(),
        };
        let jpeg = encode_jpeg(&picture, header, self.settings.jpeg_quality)?;
        Ok(Observation { jpeg, picture })
    }

    /// The metadata of an episode's bag.
    fn notes(&self, start: &Start, seed: u64) -> Result<[(&'static str, String); 7], ActionError> {
        let model = self.world.predictor();
        let start = match start {
            Start::Bag { path, offset_s } => format!("bag {} + {offset_s} s", path.display()),
            Start::Image(path) => format!("image {}", path.display()),
            Start::Topic(topic) => format!("topic {topic}"),
            Start::Frame(frame) => format!("image of {}", frame.header().frame_id),
        };
        Ok([
            ("wm.env.seed", seed.to_string()),
            ("wm.env.start", start),
            (
                "wm.env.step_period_s",
                (self.timing.step_ns() as f64 / 1e9).to_string(),
            ),
            (
                "wm.env.integration_steps",
                self.world.integration_steps().to_string(),
            ),
            ("wm.model", model.name.clone()),
            ("wm.model_hash", model.hash.clone()),
            (ActionSpace::NOTE, model.encoding.space().to_note()?),
        ])
    }

    fn free_name(&self) -> String {
        let names = (self.begun..).map(|number| format!("episode_{number:06}"));
        let mut free = names.filter(|name| !self.sessions.contains_key(name));
        // The numbers do not end: far fewer episodes are open.
        free.next().unwrap_or_default()
    }

    fn unknown(&self, name: &str) -> EnvError {
        let known: Vec<&str> = self.sessions.keys().map(String::as_str).collect();
        EnvError::Unknown {
            name: name.to_owned(),
            known: if known.is_empty() {
                "none".into()
            } else {
                known.join(", ")
            },
        }
    }
}

fn finish(session: Session, outcome: Option<bool>) -> Result<Option<PathBuf>, EnvError> {
    let recording = session.recording;
    recording
        .map(|recording| recording.finish(outcome))
        .transpose()
}

/// Checks a name that becomes a folder's: it must not lead elsewhere.
fn is_name(name: &str) -> bool {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "_-.".contains(c);
    name.len() <= MAX_NAME && !name.starts_with('.') && name.chars().all(is_plain)
}

#[cfg(test)]
mod tests;
