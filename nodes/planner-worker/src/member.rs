//! A worker from the planner's point of view.

use std::{sync::Arc, time::Duration};

use serde_bytes::ByteBuf;
use thiserror::Error;
use tokio::time::{sleep, timeout};
use wm_planner::{Costs, WorkerCounts};
use zenoh::{Session, query::Querier, sample::Locality};

use crate::{
    Answer, FunctionId, Identity, MessageError, Request,
    dispatch::ReturnReason,
    message::{costs, decode, encode, quoted},
    table::{Lease, Table},
};

/// How long a worker is excluded after a failure; doubled after each further one.
const LEAST_REST: Duration = Duration::from_secs(1);
/// The longest exclusion.
const MOST_REST: Duration = Duration::from_secs(60);
/// How long a worker may take to report its identity: it may be costing a batch of another planner.
const INTRODUCTION: Duration = Duration::from_secs(10);
/// Zenoh's own limit for queries; each query has a shorter one.
const LIMIT: Duration = Duration::from_secs(3600);

/// The reason why a worker has not replied.
#[derive(Debug, Error)]
enum AskError {
    #[error("Zenoh: {0}")]
    Zenoh(String),
    #[error("it does not reply")]
    Silent,
    #[error(transparent)]
    Message(#[from] MessageError),
    #[error("it refuses: {0}")]
    Refused(String),
    #[error("its reply belongs to another request")]
    Unasked,
}

impl From<zenoh::Error> for AskError {
    fn from(error: zenoh::Error) -> Self {
        Self::Zenoh(error.to_string())
    }
}

/// Increments a counter while it lives.
struct ActiveCount<'t> {
    table: &'t Table,
    figure: fn(&mut WorkerCounts) -> &mut usize,
}

impl<'t> ActiveCount<'t> {
    fn new(table: &'t Table, figure: fn(&mut WorkerCounts) -> &mut usize) -> Self {
        table.count(|counts| *figure(counts) += 1);
        Self { table, figure }
    }
}

impl Drop for ActiveCount<'_> {
    fn drop(&mut self) {
        self.table.count(|counts| {
            let figure = (self.figure)(counts);
            *figure = figure.saturating_sub(1);
        });
    }
}

/// Sends batches to the worker of a key, if its identity equals the planner's, until the task is aborted.
pub(crate) async fn run(table: Arc<Table>, session: Session, key: String, identity: Arc<Identity>) {
    let mut rest = LEAST_REST;
    let mut member = loop {
        let met = timeout(INTRODUCTION, Member::meet(&session, &key)).await;
        let reason = match met.unwrap_or(Err(AskError::Silent)) {
            Ok((member, other)) => match identity.require(&other) {
                Ok(()) => break member,
                Err(error) => {
                    tracing::warn!("the planner worker {key} is rejected: {error}");
                    let _refused = ActiveCount::new(&table, |counts| &mut counts.refused);
                    return std::future::pending().await;
                }
            },
            Err(error) => error,
        };
        tracing::warn!("the planner worker {key} does not report its identity: {reason}");
        sleep(rest).await;
        rest = (2 * rest).min(MOST_REST);
    };
    tracing::info!("the planner worker {key} joined");
    rest = LEAST_REST;
    loop {
        let taking_part = ActiveCount::new(&table, |counts| &mut counts.taking_part);
        let failure = loop {
            let lease = table.take().await;
            match timeout(lease.patience, member.ask(&lease)).await {
                Ok(Ok(costs)) => {
                    lease.answered(costs);
                    rest = LEAST_REST;
                }
                Ok(Err(error)) => {
                    lease.returned(ReturnReason::Failed);
                    break error;
                }
                Err(_) => {
                    lease.returned(ReturnReason::TimedOut);
                    break AskError::Silent;
                }
            }
        };
        drop(taking_part);
        tracing::warn!("the planner worker {key} is excluded for {rest:?}: {failure}");
        sleep(rest).await;
        rest = (2 * rest).min(MOST_REST);
    }
}

struct Member {
    querier: Querier<'static>,
    /// The last function that the worker received.
    known_function: Option<FunctionId>,
}

impl Member {
    /// Requests the worker's identity.
    async fn meet(session: &Session, key: &str) -> Result<(Self, Identity), AskError> {
        let querier = session
            .declare_querier(key.to_owned())
            .allowed_destination(Locality::Remote)
            .timeout(LIMIT)
            .express(true)
            .await?;
        // Zenoh announces a worker before it has a route, and replies to a query without a route at once with nothing.
        let listener = querier.matching_listener().await?;
        let mut is_matching = querier.matching_status().await?.matching();
        while !is_matching {
            is_matching = listener.recv_async().await?.matching();
        }
        drop(listener);
        let member = Self {
            querier,
            known_function: None,
        };
        match member.query(&Request::Identity).await? {
            Answer::Identity(identity) => Ok((member, identity)),
            Answer::Refused(reason) => Err(AskError::Refused(quoted(&reason))),
            _ => Err(AskError::Unasked),
        }
    }

    async fn query(&self, request: &Request) -> Result<Answer, AskError> {
        let replies = self.querier.get().payload(encode(request)?).await?;
        let reply = replies.recv_async().await.map_err(|_| AskError::Silent)?;
        match reply.result() {
            Ok(sample) => Ok(decode(&sample.payload().to_bytes())?),
            Err(error) => {
                let reason = error.payload().to_bytes();
                Err(AskError::Refused(quoted(&String::from_utf8_lossy(&reason))))
            }
        }
    }

    async fn ask(&mut self, lease: &Lease) -> Result<Costs, AskError> {
        let (batch, function) = (lease.batch(), &lease.round.function);
        let mut is_defined_there = self.known_function == Some(function.id);
        loop {
            let definition = (!is_defined_there).then(|| ByteBuf::from(function.bytes.clone()));
            let is_defined = definition.is_some();
            let request = Request::Costs {
                function: function.id,
                definition,
                // A batch has far fewer than 2^32 candidates.
                candidates: batch.len() as u32,
                values: batch.concat(),
            };
            match self.query(&request).await? {
                Answer::Costs(values) => {
                    self.known_function = Some(function.id);
                    return Ok(costs(&values, batch.len(), function.terms)?);
                }
                // The worker has dropped the function, or was restarted.
                Answer::UnknownFunction if !is_defined => is_defined_there = false,
                Answer::Refused(reason) => return Err(AskError::Refused(quoted(&reason))),
                _ => return Err(AskError::Unasked),
            }
        }
    }
}
