//! Imports LeRobot data sets as bags, and exports bags as LeRobot data sets.
//!
//! A LeRobot data set is a folder of parquet tables, mp4 videos and `meta/info.json`. Reads versions v2.1 (a file per
//! episode) and v3.0 (files with many episodes, located by `meta/episodes`), and writes v3.0, as version 0.4.4 of the
//! Python package `lerobot` (`lerobot/datasets`: `lerobot_dataset.py`, `utils.py`, `compute_stats.py`).
//!
//!
//! | feature | topic | type |
//! |---|---|---|
//! | `observation.images.NAME` | `/NAME/image_raw/compressed` | `sensor_msgs/msg/CompressedImage` |
//! | `observation.state` | `/joint_states` | `sensor_msgs/msg/JointState`, named by the feature's names |
//! | its values `arm.x` to `arm.qw`, `arm.gripper` | `/arm/end_effector_pose`, `/arm/gripper` | `PoseStamped`, `Float32` |
//! | `action` | `/wm/action` | `wm_msgs/msg/Action`, unchanged values |
//! | the task | `/task/instruction` | `std_msgs/msg/String`, latched |
//! | `next.success` of the last frame | `/task/success` | `std_msgs/msg/Bool`, latched |
//!
//! ```no_run
//! use wm_import::lerobot::{ExportOptions, ImportOptions, export, import};
//!
//! let imported = import("aloha".as_ref(), "bags".as_ref(), &ImportOptions::default())?;
//! let exported = export(&imported.bags, "again".as_ref(), &ExportOptions::default())?;
//! println!("{} episodes", exported.episodes);
//! # Ok::<(), wm_import::lerobot::LeRobotError>(())
//! ```
//!
//! Episodes that cannot be read are skipped and named.
//!
//! Not supported: other features (a remark names them), depth maps, download and upload.

mod dataset;
mod error;
mod export;
mod import;
mod info;
mod path_template;
mod stats;
mod table;
mod topics;

pub use error::LeRobotError;
pub use export::{ExportOptions, ExportReport, export};
pub use import::{ACTION_SPACE_FILE, ImportOptions, import};
