//! The learner's parameters.

use std::path::PathBuf;

use wm_wire::transport::Transports;

wm_ros::parameters! {
    /// The node's parameters.
    pub(super) struct Parameters {
        /// Folder of the recordings, the models and the log of the trainings. A learner continues with what is there.
        pub output: PathBuf = "out/learner";
        /// The model to begin with: tiny (embedded), or the path of a model folder.
        pub model: String = "tiny";
        /// YAML or JSON file with the action space of the arm; empty: that of Bridge V2.
        pub action_space: PathBuf = "";
        /// Settings of the recipes of a training, as --set of wm train model: "transition.model.frame_skip=3".
        pub recipe: Vec<String> = Vec::<String>::new();
        /// Image transport of the camera. With both, a frame that arrives twice is recorded once.
        pub image_transport: Transports = "both";
        /// Duration of a recorded bag [s].
        pub bag_seconds: f64 = 15.0, in 1.0..=600.0;
        /// Longest side of a recorded picture; larger pictures are made smaller [px].
        pub picture_side: u32 = 256, in 32..=4096;
        /// JPEG quality of the recorded pictures.
        pub jpeg_quality: u8 = 95, in 1..=100;
        /// Duration of the recordings before the first round [s].
        pub first_seconds: f64 = 90.0, in 1.0..=86400.0;
        /// Duration of new recordings before each later round [s].
        pub more_seconds: f64 = 60.0, in 1.0..=86400.0;
        /// Most bags that a round trains on: half of them the newest, the others drawn from all.
        pub most_bags: usize = 40, in 1..=100_000;
        /// Newest bags of a round that are for its test alone.
        pub test_bags: usize = 2, in 1..=1000;
        /// Duration of a round without the autoencoder's training [s]. The first one is short; each later one is planned by the
        /// duration of the one before.
        pub round_seconds: f64 = 240.0, in 1.0..=86400.0;
        /// Train the autoencoder first if the PSNR of its pictures is below this [dB].
        pub least_psnr: f64 = 25.0, in 0.0..=100.0;
        /// Optimiser steps of the autoencoder in a round that trains it.
        pub autoencoder_steps: u64 = 200, in 1..=1_000_000;
        /// Most optimiser steps of the transition model in a round.
        pub transition_steps: u64 = 1200, in 1..=1_000_000;
        /// Most optimiser steps of the inverse dynamics model in a round; 0: none, for models that only predict.
        pub idm_steps: u64 = 200, in 0..=1_000_000;
        /// Processors of the trainings, as numbers of Linux; empty: all.
        pub processors: Vec<i64> = Vec::<i64>::new();
        /// Threads of the trainings; 0: one per processor.
        pub threads: usize = 0, in 0..=1024;
        /// Added to the nice value of the trainings, as with nice(1).
        pub nice: i32 = 19, in 0..=19;
        /// Most disk space of the recordings [GiB]. Then older bags are deleted, in equal shares of the whole time.
        pub max_disk: f64 = 4.0, in 0.01..=100_000.0;
        /// Models to keep: the newest that were better than the one before them. The weights of older ones are deleted.
        pub most_models: usize = 20, in 1..=100_000;
        /// Least free disk space [GiB]. Below it, nothing is recorded or trained.
        pub min_free: f64 = 2.0, in 0.0..=100_000.0;
        /// Most memory of a training [GiB]. One that needs more is ended.
        pub max_memory: f64 = 4.0, in 0.1..=10_000.0;
        /// Temperature of the computer above which a training pauses [degrees Celsius].
        pub max_temperature: f64 = 90.0, in 20.0..=200.0;
    }
}
