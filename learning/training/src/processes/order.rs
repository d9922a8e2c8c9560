//! Orders to a worker, and their results.

use std::{
    sync::{Arc, mpsc::Sender},
    time::Duration,
};

use serde_json::Value;

use super::{frame::Part, shares::Measurement};
use crate::gradient_tree::{Node, Place};

/// The conditions of a training, which a worker must share.
#[derive(Clone, Debug)]
pub struct Offer {
    /// Version of the program.
    pub version: String,
    /// Description of the data.
    pub data: Value,
    /// Description of the computation.
    pub setup: String,
}

/// An order for a worker's thread.
#[derive(Debug)]
pub enum Order {
    /// Computes batches.
    Compute(Job),
    /// Refuses the worker, with the reason.
    Refuse(String),
}

/// Batches for a worker.
#[derive(Debug)]
pub struct Job {
    /// The batches.
    pub part: Part,
    /// Weights by parameter.
    pub weights: Arc<Vec<Vec<f32>>>,
    /// Places of the nodes that the worker returns.
    pub places: Vec<Place>,
    /// Longest time, with all transfers.
    pub limit: Duration,
    /// Whether the step waits for it.
    pub is_share: bool,
    /// Receives the result; closed without one if the worker is lost.
    pub reply: Sender<Reply>,
}

/// Result of a job.
#[derive(Debug)]
pub struct Reply {
    /// Key of the worker in the roster.
    pub worker: u64,
    /// Sums.
    pub nodes: Vec<Node>,
    /// Times.
    pub measured: Measurement,
}
