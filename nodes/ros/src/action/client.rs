//! The end of an action that sets goals.

use super::{GoalId, GoalStatus};
use crate::{
    Client, Diagnostics, Error, Shutdown,
    backend::{Backend, Reader, Sample, Sink},
    mailbox::Mailbox,
    service::RawClient,
};
use std::{
    collections::BTreeMap,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
};
use tokio::sync::watch;
use wm_msgs::{
    Action,
    action::{
        FeedbackMessage, GetResultRequest, GetResultResponse, SendGoalRequest, SendGoalResponse,
    },
    action_msgs::{CancelGoal, CancelGoalRequest, CancelGoalResponse, GoalInfo, GoalStatusArray},
    builtin_interfaces::Time,
    cdr,
};

/// The calling end of an action `A`.
///
/// ```no_run
/// use wm_msgs::wm_msgs::action::{Plan, PlanGoal};
///
/// # async fn go(node: wm_ros::Node) -> Result<(), wm_ros::Error> {
/// let client = node.action_client::<Plan>("plan_to")?;
/// client.wait_for_server().await;
/// let Some(goal) = client.send(&PlanGoal::default()).await? else {
///     println!("rejected");
///     return Ok(());
/// };
/// let mut ended = std::pin::pin!(goal.result());
/// loop {
///     tokio::select! {
///         Some(feedback) = goal.feedback() => println!("{}", feedback.best_cost),
///         result = &mut ended => {
///             let (status, result) = result?;
///             println!("{status}: {}", result.message);
///             return Ok(());
///         }
///     }
/// }
/// # }
/// ```
pub struct ActionClient<A: Action> {
    parts: Arc<Parts<A>>,
}

/// A goal that a server has accepted. Dropping it does not cancel the goal, but ends its feedback and status.
pub struct ClientGoal<A: Action> {
    id: GoalId,
    accepted: Time,
    followed: Arc<GoalUpdates<A>>,
    parts: Arc<Parts<A>>,
}

/// The endpoints of a client, made by its node.
pub(crate) struct Parts<A: Action> {
    pub(crate) name: String,
    pub(crate) send_goal: RawClient,
    pub(crate) cancel_goal: Client<CancelGoal>,
    pub(crate) get_result: RawClient,
    pub(crate) goals: Arc<Goals<A>>,
    /// Readers of feedback and status.
    pub(crate) readers: [Box<dyn Reader>; 2],
    pub(crate) backend: Arc<dyn Backend>,
    pub(crate) shutdown: Shutdown,
}

/// The goals that a client follows.
pub(crate) struct Goals<A: Action> {
    followed: Mutex<BTreeMap<GoalId, Arc<GoalUpdates<A>>>>,
    /// Whether a sample was skipped: the first is logged, further ones are only counted.
    has_refused: AtomicBool,
    diagnostics: Diagnostics,
}

/// Feedback and status of a goal.
struct GoalUpdates<A: Action> {
    feedback: Mailbox<A::Feedback>,
    status: watch::Sender<Option<GoalStatus>>,
}

impl<A: Action> Goals<A> {
    pub(crate) fn new(diagnostics: Diagnostics) -> Arc<Self> {
        Arc::new(Self {
            followed: Mutex::default(),
            has_refused: AtomicBool::new(false),
            diagnostics,
        })
    }

    /// No invariant spans the lock.
    fn followed(&self) -> MutexGuard<'_, BTreeMap<GoalId, Arc<GoalUpdates<A>>>> {
        self.followed.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn get(&self, id: GoalId) -> Option<Arc<GoalUpdates<A>>> {
        self.followed().get(&id).cloned()
    }

    /// Hands feedback to the goals; ignores feedback for goals of other clients.
    pub(crate) fn feedback_sink(self: &Arc<Self>, topic: String) -> Sink {
        let goals = Arc::clone(self);
        Box::new(move |sample| {
            let message = sample.and_then(|Sample { payload, .. }| {
                let bytes = payload.into_cdr().map_err(|error| error.to_string())?;
                cdr::from_bytes(&bytes).map_err(|error| error.to_string())
            });
            match message {
                Ok(FeedbackMessage { goal_id, feedback }) => {
                    let followed = goals.get(goal_id.into());
                    if followed.is_some_and(|followed| !followed.feedback.push(feedback)) {
                        goals
                            .diagnostics
                            .count_drop(&format!("{topic}: queue full"));
                    }
                }
                Err(reason) => goals.refuse(&topic, &reason),
            }
        })
    }

    pub(crate) fn status_sink(self: &Arc<Self>, topic: String) -> Sink {
        let goals = Arc::clone(self);
        Box::new(move |sample| {
            let message = sample.and_then(|Sample { payload, .. }| {
                let message = payload.into_message::<GoalStatusArray>();
                message.map_err(|error| error.to_string())
            });
            match message {
                Ok(message) => {
                    for news in &message.status_list {
                        if let Some(followed) = goals.get(news.goal_info.goal_id.into()) {
                            followed.hear(GoalStatus::from_number(news.status));
                        }
                    }
                }
                Err(reason) => goals.refuse(&topic, &reason),
            }
        })
    }

    fn refuse(&self, topic: &str, reason: &str) {
        if !self.has_refused.swap(true, Ordering::Relaxed) {
            tracing::warn!("{topic}: a sample is skipped, as will be others like it: {reason}");
        }
        self.diagnostics
            .count_drop(&format!("{topic}: undecodable"));
    }
}

impl<A: Action> GoalUpdates<A> {
    fn hear(&self, status: Option<GoalStatus>) {
        self.status.send_if_modified(|known| {
            let is_news = *known != status && !known.is_some_and(GoalStatus::is_end);
            if is_news {
                *known = status;
            }
            is_news
        });
    }
}

impl<A: Action> Parts<A> {
    async fn cancel(&self, which: GoalInfo) -> Result<CancelGoalResponse, Error> {
        let request = CancelGoalRequest { goal_info: which };
        self.cancel_goal.call(&request).await
    }
}

impl<A: Action> ActionClient<A> {
    pub(crate) fn new(parts: Parts<A>) -> Self {
        Self {
            parts: Arc::new(parts),
        }
    }

    /// Waits until a server is connected.
    pub async fn wait_for_server(&self) {
        let Parts {
            send_goal,
            cancel_goal,
            get_result,
            readers,
            backend,
            ..
        } = &*self.parts;
        send_goal.wait_for_service().await;
        cancel_goal.wait_for_service().await;
        get_result.wait_for_service().await;
        let mut changes = backend.changes();
        while !readers
            .iter()
            .all(|reader| backend.matched(&reader.id()) > 0)
        {
            if changes.changed().await.is_err() {
                return;
            }
        }
    }

    /// Requests a goal, and waits without a limit until the server accepts it: add a timeout. `None` if the server
    /// rejects it.
    ///
    /// # Errors
    /// The goal has no CDR form, the middleware failed, the answer is not of the type, or the context is shut down.
    pub async fn send(&self, goal: &A::Goal) -> Result<Option<ClientGoal<A>>, Error> {
        let Parts {
            send_goal, goals, ..
        } = &*self.parts;
        let id = GoalId::new();
        let request = cdr::to_bytes(&SendGoalRequest {
            goal_id: id.into(),
            goal,
        })?;
        let followed = Arc::new(GoalUpdates {
            feedback: Mailbox::new(super::FEEDBACK_QOS.depth),
            status: watch::Sender::new(None),
        });
        // Before the request, so that no feedback is missed; dropped if the goal is rejected.
        goals.followed().insert(id, Arc::clone(&followed));
        let mut goal = ClientGoal {
            id,
            accepted: Time::default(),
            followed,
            parts: Arc::clone(&self.parts),
        };
        let answer = send_goal.call(request.into()).await?;
        let SendGoalResponse { accepted, stamp } = cdr::from_bytes(&answer)?;
        goal.accepted = stamp;
        Ok(accepted.then_some(goal))
    }

    /// Requests the cancellation of goals, including those of other clients: the goal with this id, and goals accepted
    /// at this time or earlier. With neither (the default), all goals.
    ///
    /// # Errors
    /// The middleware failed, the answer is not of the type, or the context is shut down.
    pub async fn cancel(&self, which: GoalInfo) -> Result<CancelGoalResponse, Error> {
        self.parts.cancel(which).await
    }

    /// The action's absolute name.
    pub fn name(&self) -> &str {
        &self.parts.name
    }
}

impl<A: Action> ClientGoal<A> {
    /// The goal's identity.
    pub fn id(&self) -> GoalId {
        self.id
    }

    /// When the server accepted it (clock of the server).
    pub fn accepted(&self) -> Time {
        self.accepted
    }

    /// Waits for feedback; `None` once the context is shut down. Cancel safe. At most 10 wait; policy DropOldest, and each
    /// that is dropped is counted.
    pub async fn feedback(&self) -> Option<A::Feedback> {
        tokio::select! {
            biased;
            () = self.parts.shutdown.wait() => None,
            feedback = self.followed.feedback.pop() => feedback,
        }
    }

    /// Number of feedback messages dropped because they were not read in time.
    pub fn dropped(&self) -> u64 {
        self.followed.feedback.dropped()
    }

    /// The newest status received; `changed()` waits for the next.
    pub fn status(&self) -> watch::Receiver<Option<GoalStatus>> {
        self.followed.status.subscribe()
    }

    /// Requests the cancellation of the goal; `false` if the goal has ended or is being canceled already.
    ///
    /// # Errors
    /// As [`ActionClient::cancel`].
    pub async fn cancel(&self) -> Result<bool, Error> {
        let which = GoalInfo {
            goal_id: self.id.into(),
            stamp: Time::default(),
        };
        let response = self.parts.cancel(which).await?;
        Ok(response.return_code == CancelGoalResponse::ERROR_NONE)
    }

    /// Waits without a limit until the goal has ended: add a timeout. Returns its last status and its result.
    ///
    /// # Errors
    /// The server does not know the goal (any more), the middleware failed, the answer is not of the type, or the context
    /// is shut down.
    pub async fn result(&self) -> Result<(GoalStatus, A::Result), Error> {
        let Parts {
            name, get_result, ..
        } = &*self.parts;
        let request = GetResultRequest {
            goal_id: self.id.into(),
        };
        let answer = get_result.call(cdr::to_bytes(&request)?.into()).await?;
        let GetResultResponse { status, result } = cdr::from_bytes(&answer)?;
        let status = GoalStatus::from_number(status).ok_or_else(|| Error::Goal {
            action: name.clone(),
            id: self.id,
            reason: "the server does not know it, or no longer",
        })?;
        Ok((status, result))
    }
}

impl<A: Action> Drop for ClientGoal<A> {
    fn drop(&mut self) {
        self.parts.goals.followed().remove(&self.id);
    }
}
