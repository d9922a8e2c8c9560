//! Planner workers: processes that hold the same model as a planner and cost some of its candidates, asked over Zenoh.
//!
//! - A worker ([`serve`]) announces itself by a liveliness token and answers queries of its own key. It is told the
//!   [`CostFunction`](wm_planner::CostFunction) of a plan once; then actions come and costs go. Latents of candidates
//!   do not cross.
//! - A planner has a [`PlannerWorkers`], which is the [`WorkerPool`](wm_planner::WorkerPool) of its plans. A worker takes
//!   part only if its [`Identity`] is the planner's own: version, model, kernels, and the result of a trial. So a plan is
//!   the same, bit for bit, whoever costed its candidates.
//! - No batch is lost with a worker: the search costs it itself when the worker is gone, or takes longer than the search
//!   would have. A worker that fails is left out for a while, and all of it is counted.
//!
//! Not here: which candidates are tried (`wm_planner`), who may join the network (Zenoh's configuration).

mod dispatch;
mod identity;
mod member;
mod message;
mod pool;
mod serving;
mod worker;

pub use identity::{Identity, IdentityError};
pub use message::{Answer, FunctionId, MessageError, Request};
pub use pool::{PlannerWorkers, connect};
pub use serving::{Served, serve};
pub use worker::Worker;

/// Below it are the keys of all workers, `wm/planner_worker/<Zenoh id>`: of its liveliness token, and of its queries.
const WORKERS: &str = "wm/planner_worker";
