//! The context of an observation, computed before the observation arrives.

use wm_model::{
    WorldModel,
    sampler::{Noise, Observed, Prepared, Rollout},
};
use wm_motion::motion::StepAction;

use super::{Frame, History, moment::model_values};

/// The context of an observation that is still to come: all frames but the observation itself.
#[derive(Clone, Debug)]
pub struct Ahead {
    /// One model step apart, oldest first; at least one.
    earlier: Vec<Frame>,
    /// The actions from each frame to the next.
    past: Vec<StepAction>,
}

impl History {
    /// The context of an observation that is still to come at `stamp_ns`; none where a frame is missing, or it has no
    /// frame but the observation.
    pub fn ahead(&self, stamp_ns: i64) -> Option<Ahead> {
        let timing = self.timing();
        let frame = |back| {
            let wanted_ns = stamp_ns - timing.step_at(0, back);
            self.frames.near(wanted_ns, timing.tolerance_ns).cloned()
        };
        let backs = (1..self.settings.context_frames).rev();
        let earlier = backs.map(frame).collect::<Option<Vec<_>>>()?;
        if earlier.is_empty() {
            return None;
        }
        let between = earlier.iter().zip(earlier.iter().skip(1));
        let past = between.map(|(from, to)| self.step(from.stamp_ns, to.stamp_ns).ok());
        let past = past.collect::<Option<_>>()?;
        Some(Ahead { earlier, past })
    }
}

impl Ahead {
    /// The part of the computation that rollouts from the observation reuse.
    ///
    /// # Errors
    /// Where the model does not take the context.
    pub fn prepare(&self, model: &WorldModel) -> wm_model::Result<Prepared> {
        let observed = Observed {
            frames: self.earlier.iter().map(|frame| &*frame.values).collect(),
            actions: self.past.iter().map(model_values).collect(),
            // No noise is drawn.
            noise: Noise {
                seed: 0,
                first_step: 0,
            },
        };
        let sampler = &model.transition.config().sampler;
        let mut rollout = Rollout::of_values(&model.transition, sampler, &[observed])?;
        rollout.prepare()?;
        Ok(rollout.prepared())
    }
}
