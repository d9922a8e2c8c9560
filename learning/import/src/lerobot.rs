//! LeRobot datasets as bags, and bags as LeRobot datasets.
//!
//! A LeRobot dataset is a folder of parquet tables, mp4 videos and `meta/info.json`. Versions v2.1 (a file an episode)
//! and v3.0 (many episodes a file, `meta/episodes` says where each begins) are read, v3.0 is written, as version 0.4.4 of
//! the Python package `lerobot` reads and writes it (`lerobot/datasets`: `lerobot_dataset.py`, `utils.py`,
//! `compute_stats.py`).
//!
//! | feature | topic | type |
//! |---|---|---|
//! | `observation.images.NAME` | `/NAME/image_raw/compressed` | `sensor_msgs/msg/CompressedImage` |
//! | `observation.state` | `/joint_states` | `sensor_msgs/msg/JointState`, named by the feature's names |
//! | its values `arm.x` to `arm.qw`, `arm.gripper` | `/arm/end_effector_pose`, `/arm/gripper` | `PoseStamped`, `Float32` |
//! | `action` | `/wm/action` | `wm_msgs/msg/Action`, the values as they are |
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
//! An episode that cannot be read is left out by name; the others are imported.
//!
//! Not here: other features (a note names them), depth maps, download and upload.

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
pub use export::{ExportOptions, Exported, export};
pub use import::{ImportOptions, import};
