//! One worker, as a planner sees it.

use std::{sync::Arc, time::Duration};

use serde_bytes::ByteBuf;
use thiserror::Error;
use tokio::time::{sleep, timeout};
use wm_planner::{Costs, WorkerCounts};
use zenoh::{Session, query::Querier, sample::Locality};

use crate::{
    Answer, FunctionId, Identity, MessageError, Request,
    dispatch::Returned,
    message::{costs, decode, encode, quoted},
    pool::{Lease, Table},
};

/// How long a worker is left out after a failure; twice as long after each further one.
const LEAST_REST: Duration = Duration::from_secs(1);
/// And at most.
const MOST_REST: Duration = Duration::from_secs(60);
/// How long a worker may take to say what it is: it may be costing a batch of another planner.
const INTRODUCTION: Duration = Duration::from_secs(10);
/// When Zenoh itself gives a query up; each has a shorter time of its own.
const LIMIT: Duration = Duration::from_secs(3600);

/// Why a worker has not answered.
#[derive(Debug, Error)]
enum AskError {
    #[error("Zenoh: {0}")]
    Zenoh(String),
    #[error("it does not answer")]
    Silent,
    #[error(transparent)]
    Message(#[from] MessageError),
    #[error("it refuses: {0}")]
    Refused(String),
    #[error("its answer is of another question")]
    Unasked,
}

impl From<zenoh::Error> for AskError {
    fn from(error: zenoh::Error) -> Self {
        Self::Zenoh(error.to_string())
    }
}

/// Counts one more, as long as it lives.
struct Counted<'t> {
    table: &'t Table,
    figure: fn(&mut WorkerCounts) -> &mut usize,
}

impl<'t> Counted<'t> {
    fn new(table: &'t Table, figure: fn(&mut WorkerCounts) -> &mut usize) -> Self {
        table.count(|counts| *figure(counts) += 1);
        Self { table, figure }
    }
}

impl Drop for Counted<'_> {
    fn drop(&mut self) {
        self.table.count(|counts| {
            let figure = (self.figure)(counts);
            *figure = figure.saturating_sub(1);
        });
    }
}

/// Has the worker of a key cost batches, if it is of the planner's own `identity`, until it is aborted.
pub(crate) async fn run(table: Arc<Table>, session: Session, key: String, identity: Arc<Identity>) {
    let mut rest = LEAST_REST;
    let mut member = loop {
        let met = timeout(INTRODUCTION, Member::meet(&session, &key)).await;
        let reason = match met.unwrap_or(Err(AskError::Silent)) {
            Ok((member, other)) => match identity.require(&other) {
                Ok(()) => break member,
                Err(error) => {
                    tracing::warn!("the planner worker {key} takes no part: {error}");
                    let _refused = Counted::new(&table, |counts| &mut counts.refused);
                    return std::future::pending().await;
                }
            },
            Err(error) => error,
        };
        tracing::warn!("the planner worker {key} does not say what it is: {reason}");
        sleep(rest).await;
        rest = (2 * rest).min(MOST_REST);
    };
    tracing::info!("the planner worker {key} takes part");
    rest = LEAST_REST;
    loop {
        let taking_part = Counted::new(&table, |counts| &mut counts.taking_part);
        let failure = loop {
            let lease = table.take().await;
            match timeout(lease.patience, member.ask(&lease)).await {
                Ok(Ok(costs)) => {
                    lease.answered(costs);
                    rest = LEAST_REST;
                }
                Ok(Err(error)) => {
                    lease.returned(Returned::Failed);
                    break error;
                }
                Err(_) => {
                    lease.returned(Returned::TimedOut);
                    break AskError::Silent;
                }
            }
        };
        drop(taking_part);
        tracing::warn!("the planner worker {key} is left out for {rest:?}: {failure}");
        sleep(rest).await;
        rest = (2 * rest).min(MOST_REST);
    }
}

struct Member {
    querier: Querier<'static>,
    /// The function that it was told last.
    told: Option<FunctionId>,
}

impl Member {
    /// Asks the worker what it is.
    async fn meet(session: &Session, key: &str) -> Result<(Self, Identity), AskError> {
        let querier = session
            .declare_querier(key.to_owned())
            .allowed_destination(Locality::Remote)
            .timeout(LIMIT)
            .express(true)
            .await?;
        // Zenoh tells of a worker before it knows a way to it, and a query without a way is answered by nobody, at once.
        let listener = querier.matching_listener().await?;
        let mut is_matching = querier.matching_status().await?.matching();
        while !is_matching {
            is_matching = listener.recv_async().await?.matching();
        }
        drop(listener);
        let member = Self {
            querier,
            told: None,
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
        let mut is_told = self.told == Some(function.id);
        loop {
            let definition = (!is_told).then(|| ByteBuf::from(function.bytes.clone()));
            let is_defined = definition.is_some();
            let request = Request::Costs {
                function: function.id,
                definition,
                // A batch is far below 2^32.
                candidates: batch.len() as u32,
                values: batch.concat(),
            };
            match self.query(&request).await? {
                Answer::Costs(values) => {
                    self.told = Some(function.id);
                    return Ok(costs(&values, batch.len(), function.terms)?);
                }
                // It has forgotten it meanwhile, or is another process by now.
                Answer::UnknownFunction if !is_defined => is_told = false,
                Answer::Refused(reason) => return Err(AskError::Refused(quoted(&reason))),
                _ => return Err(AskError::Unasked),
            }
        }
    }
}
