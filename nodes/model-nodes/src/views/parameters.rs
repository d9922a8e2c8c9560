//! The node's parameters, checked.

use std::{collections::BTreeSet, time::Duration};

use anyhow::{Result, ensure};
use wm_model::trained_folder::EMBEDDED;
use wm_wire::transport::Transports;

/// Numbers of cameras that the node joins.
const CAMERAS: std::ops::RangeInclusive<usize> = 2..=4;

wm_ros::parameters! {
    /// The node's parameters.
    pub(super) struct Parameters {
        /// World model: the path of a model folder. Its training says how pictures are joined: the size, the fit, and the
        /// number of cameras.
        pub model: String = EMBEDDED;
        /// Image topics of the cameras, 2 to 4, in the order of --camera in the training. The picture has stamp and frame
        /// of the first.
        pub cameras: Vec<String> = Vec::<String>::new();
        /// Image transport of the cameras. With both, a frame that arrives twice counts once.
        pub image_transport: Transports = "both";
        /// Most time between the stamps of the first camera's frame and of another camera's [s]. 0: half a period of the
        /// model's actions, as in training.
        pub tolerance: Duration = 0.0, in 0.0..=60.0;
        /// Most time that a frame waits for those of the other cameras, by the stamps of the frames that arrive meanwhile
        /// [s].
        pub longest_wait: Duration = 0.5, in 0.0..=60.0;
        /// Most frames of a camera that wait for those of other cameras. At a camera's rate they must cover longest_wait.
        pub queue_size: usize = 16, in 1..=256;
        /// A camera counts as frozen if its picture repeats exactly for longer than this, or does not change for longer
        /// than this after the arm has moved [s]. Then no picture is published: in a joined one, which the other cameras
        /// change, the encoder could not notice it. 0: never, for simulators that render without noise.
        pub frozen_after: Duration = 1.0, in 0.0..=3600.0;
    }
}

impl Parameters {
    /// Refuses a wrong number of cameras.
    pub(super) fn check(&self) -> Result<()> {
        let topics = self.cameras.join(", ");
        ensure!(
            CAMERAS.contains(&self.cameras.len()),
            "parameter cameras is [{topics}]: expected {} to {} image topics, in the order of --camera in the training",
            CAMERAS.start(),
            CAMERAS.end()
        );
        let distinct: BTreeSet<&String> = self.cameras.iter().collect();
        ensure!(
            distinct.len() == self.cameras.len(),
            "parameter cameras is [{topics}]: expected each camera once"
        );
        Ok(())
    }
}
