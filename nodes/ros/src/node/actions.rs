//! Actions: their servers and clients.

use super::{Node, overrides, type_of};
use crate::{
    Error, Qos,
    action::{
        FEEDBACK_QOS, STATUS_QOS,
        client::{self, ActionClient},
        part,
        server::{self, ActionServer},
    },
    backend::{Channel, Endpoint, Reader, Sink},
    lifecycle::Gate,
    names::TypeName,
    service::Refuse,
};
use std::sync::Arc;
use wm_msgs::{
    Action, Service as _,
    action_msgs::{CancelGoal, GoalStatusArray},
};

impl Node {
    /// Serves the action `A`; read the goals from the returned server. A managed node that is not active rejects every
    /// goal.
    ///
    /// # Errors
    /// A name that ROS does not allow, or the middleware failed.
    pub fn action_server<A: Action>(&self, name: &str) -> Result<ActionServer<A>, Error> {
        let inner = &self.inner;
        let name = inner.name.resolve(name, "action")?;
        inner.interfaces.action::<A>();
        // results are sent in any state of the node
        let told = self.ungated();
        let get_result = TypeName::of_action::<A>("GetResult");
        let result_name = inner.name.resolve(&part(&name, "get_result"), "service")?;
        let feedback = TypeName::of_action::<A>("FeedbackMessage");
        let feedback_info = inner.interfaces.info(&feedback.to_string());
        let core = server::Core::new(server::Parts {
            name: name.clone(),
            clock: self.clock(),
            statuses: told.publisher::<GoalStatusArray>(&part(&name, "status"), STATUS_QOS)?,
            feedback: told.publish(
                &part(&name, "feedback"),
                feedback,
                feedback_info,
                FEEDBACK_QOS,
            )?,
            results: inner.answers(&result_name, get_result.clone())?,
        });
        let canceling = {
            let core = Arc::clone(&core);
            inner.answering(
                &part(&name, "cancel_goal"),
                TypeName::service(CancelGoal::PACKAGE, CancelGoal::NAME),
                move |request| core.cancel(request),
            )?
        };
        let sink = core.result_sink(server::unknown::<A>()?);
        let results = inner.requests(result_name, get_result, true, sink)?;
        let refuse: Refuse = Box::new(|_reason| server::rejection());
        let gate = self.gate.clone().unwrap_or_else(|| {
            let gate = Gate::default();
            self.open(&gate);
            gate
        });
        let requests = inner.service(
            &part(&name, "send_goal"),
            TypeName::of_action::<A>("SendGoal"),
            true,
            Some((gate, refuse)),
        )?;
        Ok(ActionServer::new(core, requests, [canceling, results]))
    }

    /// A client of the action `A` of this name.
    ///
    /// # Errors
    /// A name that ROS does not allow, or the middleware failed.
    pub fn action_client<A: Action>(&self, name: &str) -> Result<ActionClient<A>, Error> {
        let inner = &self.inner;
        let name = inner.name.resolve(name, "action")?;
        inner.interfaces.action::<A>();
        let goals = client::Goals::new(self.diagnostics());
        let feedback = TypeName::of_action::<A>("FeedbackMessage");
        let readers = [
            self.hear(&part(&name, "feedback"), feedback, FEEDBACK_QOS, |topic| {
                goals.feedback_sink(topic)
            })?,
            self.hear(
                &part(&name, "status"),
                type_of::<GoalStatusArray>(),
                STATUS_QOS,
                |topic| goals.status_sink(topic),
            )?,
        ];
        let raw_client = |service: &str, made: &str| {
            inner.client(&part(&name, service), TypeName::of_action::<A>(made))
        };
        Ok(ActionClient::new(client::Parts {
            send_goal: raw_client("send_goal", "SendGoal")?,
            cancel_goal: self.client::<CancelGoal>(&part(&name, "cancel_goal"))?,
            get_result: raw_client("get_result", "GetResult")?,
            goals,
            readers,
            backend: Arc::clone(inner.backend()),
            shutdown: self.shutdown(),
            name,
        }))
    }

    /// Subscribes to a topic; `sink` makes the sink from the topic's absolute name.
    fn hear(
        &self,
        topic: &str,
        type_name: TypeName,
        qos: Qos,
        sink: impl FnOnce(String) -> Sink,
    ) -> Result<Box<dyn Reader>, Error> {
        let name = self.inner.name.resolve(topic, "topic")?;
        let node = self.fully_qualified_name();
        let parameters = &self.inner.parameters;
        let qos = overrides::apply(parameters, node, &name, "subscription", qos)?;
        let endpoint = Endpoint {
            channel: Channel::Topic,
            name: name.clone(),
            type_info: self.inner.interfaces.info(&type_name.to_string()),
            type_name,
            qos,
            receives_own: true,
            has_siblings: false,
        };
        self.inner.backend().reader(node, &endpoint, sink(name))
    }
}
