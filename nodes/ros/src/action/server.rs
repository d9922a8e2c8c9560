//! The end of an action that executes goals.

use super::{
    GoalId, GoalStatus,
    goals::{Availability, End, Goals},
};
use crate::{
    Clock, Error, Publisher, RawPublisher,
    backend::{Reader, RequestId, Sample, Sink, Writer},
    service::{self, RawCall, RawService},
    waiting_call::Arrival,
};
use bytes::Bytes;
use std::{
    marker::PhantomData,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Instant,
};
use tokio::sync::watch;
use wm_msgs::{
    Action,
    action::{
        FeedbackMessage, GetResultRequest, GetResultResponse, SendGoalRequest, SendGoalResponse,
    },
    action_msgs::{CancelGoalRequest, GoalStatus as StatusMessage, GoalStatusArray},
    cdr::{self, CdrError},
};

/// The serving end of an action `A`. It answers requests to cancel goals and for results until it is dropped.
///
/// At most 64 goals are under way, and more are rejected; 64 results are kept, for 15 minutes each. Every request to
/// cancel a goal is accepted: [`ServerGoal::canceling`] returns, and the node ends the goal when it can.
///
/// ```no_run
/// use wm_msgs::wm_msgs::action::{Plan, PlanFeedback, PlanResult};
/// use wm_ros::{Error, ServerGoal};
///
/// async fn plan(goal: &ServerGoal<Plan>) -> Result<PlanResult, Error> {
///     goal.publish_feedback(&PlanFeedback { best_cost: 0.5, ..PlanFeedback::default() })?;
///     Ok(PlanResult { plans: 1, ..PlanResult::default() })
/// }
///
/// # async fn serve(node: wm_ros::Node) -> Result<(), Error> {
/// let mut server = node.action_server::<Plan>("plan_to")?;
/// while let Some(request) = server.recv().await {
///     if request.goal.goal.images.is_empty() {
///         request.reject();
///         continue;
///     }
///     let goal = request.accept()?;
///     tokio::select! {
///         () = goal.canceling() => goal.cancel(PlanResult::default())?,
///         result = plan(&goal) => goal.succeed(result?)?,
///     }
/// }
/// # Ok(())
/// # }
/// ```
pub struct ActionServer<A> {
    core: Arc<Core>,
    requests: RawService,
    /// Readers of requests to cancel goals and for results.
    _answering: [Box<dyn Reader>; 2],
    of: PhantomData<fn(A)>,
}

/// State shared by a server and its goals.
pub(crate) struct Core {
    name: String,
    /// Each result as its answer, in CDR.
    goals: Mutex<Goals<Bytes, RequestId>>,
    /// Wakes tasks that wait for a cancellation.
    changes: watch::Sender<()>,
    clock: Clock,
    statuses: Publisher<GoalStatusArray>,
    feedback: RawPublisher,
    /// Answers requests for results.
    results: Arc<dyn Writer>,
}

/// A goal that a client requests, to be accepted or rejected; dropping it rejects the goal.
#[must_use = "it is rejected where it is dropped"]
pub struct GoalRequest<A: Action> {
    /// What the client requests.
    pub goal: A::Goal,
    id: GoalId,
    call: RawCall,
    core: Arc<Core>,
}

/// An accepted goal that has not ended. Dropping it aborts the goal with an empty result.
#[must_use = "the goal is aborted where it is dropped"]
pub struct ServerGoal<A: Action> {
    /// What the client requests.
    pub goal: A::Goal,
    id: GoalId,
    core: Arc<Core>,
}

/// The endpoints of a server, made by its node.
pub(crate) struct Parts {
    pub(crate) name: String,
    pub(crate) clock: Clock,
    pub(crate) statuses: Publisher<GoalStatusArray>,
    pub(crate) feedback: RawPublisher,
    pub(crate) results: Arc<dyn Writer>,
}

impl Core {
    pub(crate) fn new(parts: Parts) -> Arc<Self> {
        let Parts {
            name,
            clock,
            statuses,
            feedback,
            results,
        } = parts;
        Arc::new(Self {
            name,
            goals: Mutex::default(),
            changes: watch::Sender::new(()),
            clock,
            statuses,
            feedback,
            results,
        })
    }

    /// No invariant spans the lock.
    fn goals(&self) -> MutexGuard<'_, Goals<Bytes, RequestId>> {
        self.goals.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Publishes the status of all goals. The caller holds the lock, so that statuses are published in the order of the
    /// changes.
    fn tell(&self, goals: &Goals<Bytes, RequestId>) {
        if let Err(error) = self.statuses.publish(&goals.statuses()) {
            tracing::warn!("{}: cannot publish a status: {error}", self.name);
        }
        self.changes.send_replace(());
    }

    /// Answers a request to cancel goals.
    pub(crate) fn cancel(&self, request: &[u8]) -> Result<Vec<u8>, CdrError> {
        let request: CancelGoalRequest = cdr::from_bytes(request)?;
        let mut goals = self.goals();
        let response = goals.cancel(&request);
        if !response.goals_canceling.is_empty() {
            self.tell(&goals);
        }
        cdr::to_bytes(&response)
    }

    /// Answers requests for results; `unknown` is the reply for unknown goals.
    pub(crate) fn result_sink(self: &Arc<Self>, unknown: Bytes) -> Sink {
        let core = Arc::clone(self);
        Box::new(move |sample| {
            let Ok(Sample {
                payload,
                request: Some(who),
                ..
            }) = sample
            else {
                tracing::warn!(
                    "{}: a request that cannot be read or answered is skipped",
                    core.name
                );
                return;
            };
            let request = payload.into_cdr().and_then(|bytes| cdr::from_bytes(&bytes));
            match request {
                Ok(GetResultRequest { goal_id }) => core.ask(goal_id.into(), who, &unknown),
                Err(error) => tracing::warn!("{}: a request is skipped: {error}", core.name),
            }
        })
    }

    fn ask(&self, id: GoalId, who: RequestId, unknown: &Bytes) {
        let availability = self.goals().ask(id, who, Instant::now());
        match availability {
            Availability::Ended(result) => self.answer(result, who),
            Availability::Unknown => self.answer(unknown.clone(), who),
            Availability::Later { forgot: false } => {}
            Availability::Later { forgot: true } => tracing::warn!(
                "{}: too many wait for the result of the goal {id}; the oldest is dropped",
                self.name
            ),
        }
    }

    fn answer(&self, result: Bytes, who: RequestId) {
        if let Err(error) = service::send(&*self.results, &self.name, result, who) {
            tracing::warn!("{}: a result is not sent: {error}", self.name);
        }
    }

    fn accept(&self, id: GoalId) -> Result<SendGoalResponse, Error> {
        let stamp = self.clock.now();
        let accepted = self.goals().accept(id, stamp, Instant::now());
        accepted.map_err(|refused| Error::Goal {
            action: self.name.clone(),
            id,
            reason: refused.reason(),
        })?;
        Ok(SendGoalResponse {
            accepted: true,
            stamp,
        })
    }

    fn execute(&self, id: GoalId) {
        let mut goals = self.goals();
        goals.execute(id);
        self.tell(&goals);
    }

    /// Ends a goal, unless it has ended already.
    fn end<A: Action>(&self, id: GoalId, end: End, result: A::Result) -> Result<(), Error> {
        let response = |status: GoalStatus| -> Result<Bytes, CdrError> {
            let status = status.number();
            Ok(cdr::to_bytes(&GetResultResponse { status, result })?.into())
        };
        let mut goals = self.goals();
        let Some((result, waiting)) = goals.end(id, end, Instant::now(), response)? else {
            return Ok(());
        };
        self.tell(&goals);
        drop(goals);
        for who in waiting {
            self.answer(result.clone(), who);
        }
        Ok(())
    }
}

/// The reply to a request for the result of an unknown goal.
pub(crate) fn unknown<A: Action>() -> Result<Bytes, CdrError> {
    let response = GetResultResponse {
        status: StatusMessage::STATUS_UNKNOWN,
        result: A::Result::default(),
    };
    Ok(cdr::to_bytes(&response)?.into())
}

/// The reply that rejects a goal.
pub(crate) fn rejection() -> Result<Vec<u8>, CdrError> {
    cdr::to_bytes(&SendGoalResponse::default())
}

impl<A: Action> ActionServer<A> {
    /// `requests` rejects goals that are dropped without a reply.
    pub(crate) fn new(
        core: Arc<Core>,
        requests: RawService,
        answering: [Box<dyn Reader>; 2],
    ) -> Self {
        Self {
            core,
            requests,
            _answering: answering,
            of: PhantomData,
        }
    }

    /// Waits for a goal; `None` once the context is shut down. Cancel safe. A request of another type, with the id of
    /// another goal, or beyond the limit is rejected, reported and skipped.
    pub async fn recv(&mut self) -> Option<GoalRequest<A>> {
        loop {
            let call = self.requests.recv().await?;
            let SendGoalRequest { goal_id, goal } = match cdr::from_bytes(&call.request) {
                Ok(request) => request,
                Err(error) => {
                    tracing::warn!("{}: a goal is rejected: {error}", self.name());
                    continue;
                }
            };
            let id = GoalId::from(goal_id);
            if let Some(refused) = self.core.goals().refuses(id) {
                let reason = refused.reason();
                tracing::warn!("{}: the goal {id} is rejected: {reason}", self.name());
                continue;
            }
            return Some(GoalRequest {
                goal,
                id,
                call,
                core: Arc::clone(&self.core),
            });
        }
    }

    /// When its oldest waiting goal arrived.
    pub(crate) fn arrival(&self) -> Arrival {
        self.requests.arrival()
    }

    /// The action's absolute name.
    pub fn name(&self) -> &str {
        &self.core.name
    }
}

impl<A: Action> GoalRequest<A> {
    /// The goal's identity.
    pub fn id(&self) -> GoalId {
        self.id
    }

    /// Accepts the goal, and begins to execute it.
    ///
    /// # Errors
    /// A goal with its id, or too many goals, were accepted since it arrived, or the middleware failed.
    pub fn accept(self) -> Result<ServerGoal<A>, Error> {
        let goal = self.defer()?;
        goal.execute();
        Ok(goal)
    }

    /// Accepts the goal; it waits for [`ServerGoal::execute`].
    ///
    /// # Errors
    /// As [`accept`](Self::accept).
    pub fn defer(self) -> Result<ServerGoal<A>, Error> {
        let Self {
            goal,
            id,
            call,
            core,
        } = self;
        let response = core.accept(id)?;
        // aborted if the reply fails
        let goal = ServerGoal { goal, id, core };
        call.respond(cdr::to_bytes(&response)?.into())?;
        goal.core.tell(&goal.core.goals());
        Ok(goal)
    }

    /// Rejects the goal.
    pub fn reject(self) {}
}

impl<A: Action> ServerGoal<A> {
    /// The goal's identity.
    pub fn id(&self) -> GoalId {
        self.id
    }

    /// Begins to execute a goal that was [deferred](GoalRequest::defer).
    pub fn execute(&self) {
        self.core.execute(self.id);
    }

    /// Publishes feedback. Never blocks.
    ///
    /// # Errors
    /// The feedback has no CDR form, or the middleware failed.
    pub fn publish_feedback(&self, feedback: &A::Feedback) -> Result<(), Error> {
        let message = FeedbackMessage {
            goal_id: self.id.into(),
            feedback,
        };
        let bytes = cdr::to_bytes(&message)?;
        self.core.feedback.publish(bytes.into())
    }

    /// Whether a client requested the cancellation of the goal.
    pub fn is_canceling(&self) -> bool {
        self.core.goals().status(self.id) == Some(GoalStatus::Canceling)
    }

    /// Waits until a client requests the cancellation of the goal. Cancel safe.
    pub async fn canceling(&self) {
        let mut changes = self.core.changes.subscribe();
        while !self.is_canceling() {
            if changes.changed().await.is_err() {
                // never: the sender lives in `self`
                return;
            }
        }
    }

    /// Ends the goal as succeeded.
    ///
    /// # Errors
    /// The result has no CDR form; the goal is aborted then.
    pub fn succeed(self, result: A::Result) -> Result<(), Error> {
        self.core.end::<A>(self.id, End::Succeeded, result)
    }

    /// Ends the goal as aborted.
    ///
    /// # Errors
    /// As [`succeed`](Self::succeed).
    pub fn abort(self, result: A::Result) -> Result<(), Error> {
        self.core.end::<A>(self.id, End::Aborted, result)
    }

    /// Ends the goal as canceled; as aborted if no client requested its cancellation.
    ///
    /// # Errors
    /// As [`succeed`](Self::succeed).
    pub fn cancel(self, result: A::Result) -> Result<(), Error> {
        self.core.end::<A>(self.id, End::Canceled, result)
    }
}

impl<A: Action> Drop for ServerGoal<A> {
    fn drop(&mut self) {
        let ended = self
            .core
            .end::<A>(self.id, End::Aborted, A::Result::default());
        if let Err(error) = ended {
            tracing::warn!(
                "{}: the goal {} is not ended: {error}",
                self.core.name,
                self.id
            );
        }
    }
}
