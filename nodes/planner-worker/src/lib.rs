//! Planner workers: processes with the same model as a planner that cost some of its candidates over Zenoh.
//!
//! - A worker ([`serve`]) announces itself by a liveliness token and answers queries of its own key. It receives the
//!   [`CostFunction`](wm_planner::CostFunction) of a plan once; then it receives actions and returns costs. Latents of
//!   candidates are not sent.
//! - A planner has [`PlannerWorkers`], the [`WorkerPool`](wm_planner::WorkerPool) of its plans. A worker takes part
//!   only if its [`Identity`] equals the planner's: version, model, kernels, and the result of a trial. So a plan is
//!   the same, bit for bit, with any workers.
//! - No batch is lost: the search costs it itself if the worker disappears or is slow. A failing worker is excluded for
//!   a while. All of this is counted.
//!
//! Not here: which candidates are tried (`wm_planner`), who may join the network (Zenoh's configuration).

mod dispatch;
mod identity;
mod member;
mod message;
mod pool;
mod serving;
mod table;
mod worker;

pub use identity::{Identity, IdentityError};
use message::{Answer, FunctionId, MessageError, Request};
pub use pool::{PlannerWorkers, connect};
pub use serving::{ServiceCounts, serve};
use worker::Worker;

/// The prefix of all workers' keys, `wm/planner_worker/<Zenoh id>`: of liveliness tokens and queries.
const WORKERS: &str = "wm/planner_worker";
