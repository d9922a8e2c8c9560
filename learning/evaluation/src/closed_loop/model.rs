//! The model that planners see and imagine with.

use std::sync::Arc;

use anyhow::{Context as _, Result, ensure};
use candle_core::{Device, Tensor};
use image::RgbImage;
use wm_model::{Encoder, WorldModel};
use wm_motion::actions::ActionSpace;
use wm_sim::EndEffectorAction;
use wm_zoo::{ModelFolder, idm::TrainedIdm};

use nalgebra::Vector3;

/// Encoder, transition model and inverse dynamics model.
pub struct Model {
    encoder: Box<dyn Encoder>,
    pub world: WorldModel,
    pub idm: Option<Arc<TrainedIdm>>,
}

impl Model {
    /// Loads a model whose actions the simulated arm takes.
    pub fn load(folder: &ModelFolder) -> Result<Self> {
        let (encoder, world) = (folder.encoder()?, folder.world_model()?);
        let space = world.encoding.space();
        space.expect_same(&ActionSpace::bridge(), "the model", "the simulated arm")?;
        Ok(Self {
            encoder,
            world,
            idm: folder.idm()?.map(Arc::new),
        })
    }

    /// The latent (h, w, C) of a picture.
    pub fn encode(&self, picture: &RgbImage) -> Result<Tensor> {
        let pixels = self.encoder.prepare(picture)?;
        Ok(self.encoder.encode(&pixels)?.squeeze(0)?)
    }

    /// Actions of the arm in one model step.
    pub fn frames_per_step(&self) -> usize {
        self.world.encoding.frame_skip()
    }

    /// What the arm does in one model step of this model action: the same in each of its frames.
    pub fn commands(&self, action: &[f32]) -> Result<Vec<EndEffectorAction>> {
        let whole = self.world.encoding.decode_step(action)?;
        ensure!(
            whole.len() == 7,
            "an action of {} values, not 7",
            whole.len()
        );
        let frames = self.frames_per_step();
        let part = |index: usize| -> f64 {
            f64::from(whole.get(index).copied().unwrap_or_default()) / frames as f64
        };
        let command = EndEffectorAction {
            translation: Vector3::new(part(0), part(1), part(2)),
            rotation: Vector3::new(part(3), part(4), part(5)),
            gripper: part(6) * frames as f64,
        };
        Ok(vec![command; frames])
    }

    /// The model action (1, A) of what the arm did in the frames of one model step.
    pub fn action(&self, done: &[EndEffectorAction]) -> Result<Tensor> {
        let values: Vec<[f32; 7]> = done.iter().map(EndEffectorAction::values).collect();
        let action = self.world.encoding.encode_step(&values)?;
        let shape = (1, action.values.len());
        Ok(Tensor::from_vec(action.values, shape, &Device::Cpu)?)
    }

    /// The model's value for a gripper that is to be open, or closed.
    pub fn gripper(&self, is_open: bool) -> Result<f32> {
        let action = EndEffectorAction {
            translation: Vector3::zeros(),
            rotation: Vector3::zeros(),
            gripper: f64::from(u8::from(is_open)),
        };
        let action = self.action(&vec![action; self.frames_per_step()])?;
        let values = action.flatten_all()?.to_vec1::<f32>()?;
        values
            .get(6)
            .copied()
            .context("an action without a gripper")
    }
}
