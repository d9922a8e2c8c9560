//! The encoder's parameters.

use std::time::Duration;

use wm_wire::{latent_message::LatentDtype, transport::Transports};

wm_ros::parameters! {
    /// The node's parameters.
    pub(super) struct Parameters {
        /// Number type of the latents. In f16 a latent of the embedded model takes 6 KB.
        pub dtype: LatentDtype = "f16", one_of {
            "f32" => LatentDtype::F32, "f16" => LatentDtype::F16, "bf16" => LatentDtype::Bf16,
        };
        /// Image transport of the camera. With both, a frame that arrives twice counts once.
        pub image_transport: Transports = "both";
        /// Time from one camera frame to the next [s]; 0: as in the model's training. With context_frames, it says which
        /// frames are encoded where encoding is slower than the camera.
        pub frame_period: f64 = 0.0, in 0.0..=60.0;
        /// Number of observed frames that predictions start from, one model step apart, as on the predictor.
        pub context_frames: usize = 2, in 1..=64;
        /// A camera counts as frozen if its picture repeats exactly for longer than this, or does not change for longer
        /// than this after the arm has moved [s]. Then the planner publishes no plan. 0: never, for simulators that
        /// render without noise.
        pub frozen_after: Duration = 1.0, in 0.0..=3600.0;
    }
}
