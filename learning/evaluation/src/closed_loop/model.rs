//! The model that planners see and imagine with.

use std::sync::Arc;

use anyhow::{Context as _, Result, bail, ensure};
use candle_core::{Device, Tensor};
use image::RgbImage;
use wm_model::{Decoder, Encoder, WorldModel};
use wm_motion::actions::ActionSpace;
use wm_sim::EndEffectorAction;
use wm_zoo::{ModelFolder, distance::TrainedDistance, idm::TrainedIdm, subgoals::TrainedSubgoals};

use nalgebra::Vector3;

/// Encoder, transition model, and the networks that planners use besides.
pub struct Model {
    encoder: Box<dyn Encoder>,
    pub decoder: Option<Box<dyn Decoder>>,
    pub world: WorldModel,
    pub idm: Option<Arc<TrainedIdm>>,
    pub subgoals: Option<TrainedSubgoals>,
    pub distance: Option<Arc<TrainedDistance>>,
}

impl Model {
    /// Loads a model whose actions suit the simulated arm.
    pub fn load(folder: &ModelFolder) -> Result<Self> {
        let (encoder, world) = (folder.encoder()?, folder.world_model()?);
        let space = world.encoding.space();
        space.expect_same(&ActionSpace::bridge(), "the model", "the simulated arm")?;
        let subgoals = folder.subgoals()?;
        if let Some(subgoals) = &subgoals {
            let (own, step) = (subgoals.frame_skip(), world.encoding.frame_skip());
            ensure!(
                own == step,
                "the subgoals are for model steps of {own} camera frames, the transition model for {step}"
            );
        }
        Ok(Self {
            encoder,
            decoder: folder.decoder()?,
            world,
            idm: folder.idm()?.map(Arc::new),
            subgoals,
            distance: folder.distance()?.map(Arc::new),
        })
    }

    /// The latent (h, w, C) of a picture.
    pub fn encode(&self, picture: &RgbImage) -> Result<Tensor> {
        let pixels = self.encoder.prepare(picture)?;
        Ok(self.encoder.encode(&pixels)?.squeeze(0)?)
    }

    /// A camera picture in the size of the model's pictures.
    pub fn resized(&self, picture: &RgbImage) -> Result<RgbImage> {
        Ok(self.encoder.framing().apply(picture)?)
    }

    /// Actions of the arm in one model step.
    pub fn frames_per_step(&self) -> usize {
        self.world.encoding.frame_skip()
    }

    /// The arm's actions for one model action: the same in each frame of the step.
    pub fn commands(&self, action: &[f32]) -> Result<Vec<EndEffectorAction>> {
        let whole = self.world.encoding.decode_step(action)?;
        let [x, y, z, roll, pitch, yaw, gripper] = *whole.as_slice() else {
            bail!("expected an action of 7 values, got {}", whole.len());
        };
        let frames = self.frames_per_step();
        let part = |value: f32| f64::from(value) / frames as f64;
        let command = EndEffectorAction {
            translation: Vector3::new(part(x), part(y), part(z)),
            rotation: Vector3::new(part(roll), part(pitch), part(yaw)),
            gripper: part(gripper) * frames as f64,
        };
        Ok(vec![command; frames])
    }

    /// The model action (1, A) of the arm's actions in one model step.
    pub fn action(&self, done: &[EndEffectorAction]) -> Result<Tensor> {
        let values: Vec<[f32; 7]> = done.iter().map(EndEffectorAction::values).collect();
        let action = self.world.encoding.encode_step(&values)?;
        let shape = (1, action.values.len());
        Ok(Tensor::from_vec(action.values, shape, &Device::Cpu)?)
    }

    /// The model's value of an open or closed gripper.
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
