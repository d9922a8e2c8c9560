//! A worker on the network.

use anyhow::{Result, anyhow};
use tokio::{
    runtime::Builder,
    signal::unix::{SignalKind, signal},
    sync::mpsc::{self, error::TrySendError},
    task::block_in_place,
};
use wm_model::WorldModel;
use wm_ros::zenoh::NetworkArguments;
use zenoh::{Wait as _, query::Query, sample::Locality};

use crate::{Answer, Identity, WORKERS, Worker, message::encode};

/// The most waiting queries; a planner has one open at a time. Bounds memory.
const QUEUED: usize = 16;
/// Messages are small and few; the model computes on its own threads.
const THREADS: usize = 2;

/// Counters of a worker.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ServiceCounts {
    /// Costed batches.
    pub answered: u64,
    /// Refused queries.
    pub refused: u64,
}

/// Answers queries on the network until SIGINT or SIGTERM.
///
/// # Errors
/// The configuration is wrong, an endpoint cannot be listened on, or the model fails at its trial.
pub fn serve(model: &WorldModel, network: &NetworkArguments) -> Result<ServiceCounts> {
    let config = network.resolve()?;
    let identity = Identity::of(model)?;
    tracing::info!(
        "model {} ({:.12}), {}",
        model.name,
        identity.model_hash,
        identity.kernels
    );
    let mut worker = Worker::new(&model.transition, identity);
    let runtime = Builder::new_multi_thread()
        .worker_threads(THREADS)
        .enable_all()
        .build()?;
    runtime.block_on(async {
        let mut terminated = signal(SignalKind::terminate())?;
        let session = wm_ros::zenoh::open(config).await?;
        let key = format!("{WORKERS}/{}", session.zid());
        let (queries, mut waiting) = mpsc::channel(QUEUED);
        let failed = |error| anyhow!("cannot serve {key}: {error}");
        let queryable = session
            .declare_queryable(key.clone())
            .allowed_origin(Locality::Remote)
            .callback(move |query: Query| {
                if let Err(TrySendError::Full(query)) = queries.try_send(query) {
                    let refused = Answer::Refused(format!("{QUEUED} queries are waiting already"));
                    tracing::debug!("{}: {refused:?}", query.key_expr());
                    if let Ok(bytes) = encode(&refused) {
                        query.reply(query.key_expr().clone(), bytes).wait().ok();
                    }
                }
            })
            .await
            .map_err(failed)?;
        let token = session.liveliness().declare_token(key.clone()).await;
        let token = token.map_err(failed)?;
        tracing::info!("answering {key}");
        let mut served = ServiceCounts::default();
        loop {
            let query = tokio::select! {
                biased;
                _ = terminated.recv() => break,
                stopped = tokio::signal::ctrl_c() => { stopped?; break }
                query = waiting.recv() => match query {
                    Some(query) => query,
                    None => break,
                },
            };
            let request = query.payload().map(|payload| payload.to_bytes());
            // A query without a payload is an invalid request, which is refused.
            let answer = block_in_place(|| worker.answer(&request.unwrap_or_default()));
            match &answer {
                Answer::Costs(_) => served.answered += 1,
                Answer::Refused(reason) => {
                    served.refused += 1;
                    // Repeated invalid requests do not fill the log.
                    match served.refused {
                        1 => tracing::warn!("refused: {reason}; further ones are only counted"),
                        _ => tracing::debug!("refused: {reason}"),
                    }
                }
                Answer::Identity(_) | Answer::UnknownFunction => {}
            }
            if let Err(error) = query.reply(key.clone(), encode(&answer)?).await {
                tracing::warn!("an answer cannot be sent: {error}");
            }
        }
        // Closing the session removes the liveliness token, so planners notice at once.
        token.undeclare().await.map_err(failed)?;
        queryable.undeclare().await.map_err(failed)?;
        session.close().await.map_err(failed)?;
        Ok(served)
    })
}
