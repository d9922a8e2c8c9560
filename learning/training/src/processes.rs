//! Training in several processes, on one machine or several.
//!
//! Each step is synchronous: a coordinator sends the weights to its workers, each process computes the gradient of its
//! share of the step's batches, and the coordinator sums them in a [fixed order](crate::gradient_tree) and takes the
//! step. So the model has the same bytes for any number of processes, and workers have no state: they join and leave at
//! any time, and a lost share is computed again. Averaging weights after many local steps (local SGD, DiLoCo) needs less
//! traffic, but the model would depend on who took part. A step of the transition model `tiny` takes more than a second
//! of one core; its 12 MB of weights take a tenth of a second at 1 Gbit/s, to each worker and back.
//!
//! The connection is TCP with [frames](frame) of a few kinds. Nothing in it is authenticated or encrypted. A new worker
//! first computes a batch that the coordinator computes too, so that another build or other data are detected.

mod connection;
mod coordinator;
mod frame;
mod limits;
mod message;
mod order;
mod peer;
mod roster;
mod shares;
mod trial;
mod worker;

pub(crate) use coordinator::Coordinator;
pub(crate) use limits::Limits;
pub(crate) use order::Offer;
pub(crate) use worker::{Computation, Worker};

#[cfg(test)]
mod tests;
