//! The topics that the view subscribes to.

use crate::{
    control,
    picture_subscription::{PictureSubscription, Publishers},
    shared::Shared,
    state::Topic,
    status::InputTopic,
};
use anyhow::Result;
use wm_camera::camera_info::info_topic;
use wm_msgs::{
    diagnostic_msgs::DiagnosticArray,
    sensor_msgs::CameraInfo,
    std_msgs::String as Text,
    tf2_msgs::TFMessage,
    visualization_msgs::MarkerArray,
    wm_msgs::{
        Action, ActionCandidates, ActionChunk, Assessment, ExecutorStatus, Goal, LearnerStatus,
        Plan, Prediction, PredictionError,
    },
};
use wm_ros::{EndpointSet, EndpointSpec, Error, Log, Node, Qos, Subscription};

/// Best effort, which matches every publisher and which none waits for; room for the rollouts that come at once.
const BURST: Qos = Qos::best_effort(64);
/// Of a topic that is latched: a message that is lost would be missing until the next one, which may never come.
const LATCHED: Qos = Qos::reliable(1);
/// Of frames that do not move: several messages of several publishers.
const STATIC: Qos = Qos::reliable(64);
/// Of a camera: the newest few.
const NEWEST: Qos = Qos::sensor_data();

/// The camera's topic, unless a parameter names another.
pub(crate) const CAMERA: &str = "/camera/image_raw";

wm_ros::endpoints! {
    /// Topics.
    pub(crate) struct Inputs {
        /// The camera's frames. The parameter camera_topic sets the topic.
        pub camera: PictureSubscription = CAMERA, qos(NEWEST), made(|node, _, qos| {
            let topic: String = node.parameter("camera_topic")?;
            PictureSubscription::new(node, &topic, qos)
        });
        /// How it sees, beside its frames.
        pub camera_infos: Subscription<CameraInfo> = "/camera/camera_info", qos(Qos::best_effort(1)), made(|node, _, qos| {
            let images: String = node.parameter("camera_topic")?;
            node.subscription(&info_topic(&images), qos)
        });
        /// Where it is, and where the arm is.
        pub transforms: Subscription<TFMessage> = "/tf", qos(BURST);
        /// The same, of what does not move.
        pub static_transforms: Subscription<TFMessage> = "/tf_static", qos(STATIC), made(Node::subscription_to_any);
        /// Predicted latents, of which only the stamps and steps are used.
        pub predicted: Subscription<Prediction> = "predicted", qos(BURST);
        /// Predicted pictures.
        pub pictures: PictureSubscription = "predicted/image", qos(BURST);
        /// How a camera picture becomes one of their size and aspect.
        pub fit: Subscription<Text> = "predicted/fit", qos(LATCHED), made(Node::subscription_to_any);
        /// Errors of the predictions.
        pub errors: Subscription<PredictionError> = "prediction_error", qos(BURST);
        /// Actions that the robot takes.
        pub actions: Subscription<Action> = "action", qos(BURST);
        /// Actions that a policy will take next.
        pub chunks: Subscription<ActionChunk> = "action_chunk", qos(NEWEST);
        /// The goal's picture.
        pub goal_pictures: PictureSubscription = "goal/image", qos(LATCHED), made(PictureSubscription::of_latched);
        /// Goals of other kinds.
        pub goals: Subscription<Goal> = "goal", qos(LATCHED), made(Node::subscription_to_any);
        /// Plans.
        pub plans: Subscription<Plan> = "plan", qos(NEWEST);
        /// Where a plan leads.
        pub markers: Subscription<MarkerArray> = "markers", qos(BURST);
        /// What the camera would see after a plan.
        pub outcomes: PictureSubscription = "plan/image", qos(NEWEST);
        /// The subgoals of a plan side by side.
        pub subgoals: PictureSubscription = "plan/subgoals/image", qos(NEWEST);
        /// A policy's candidates.
        pub candidates: Subscription<ActionCandidates> = "action_candidates", qos(NEWEST);
        /// What they would do.
        pub assessments: Subscription<Assessment> = "assessment", qos(NEWEST);
        /// The same in pictures.
        pub candidate_pictures: PictureSubscription = "candidates/image", qos(NEWEST);
        /// What the executor does.
        pub executor: Subscription<ExecutorStatus> = "executor/status", qos(LATCHED), made(Node::subscription_to_any);
        /// What the learner does.
        pub learner: Subscription<LearnerStatus> = "learner/status", qos(LATCHED), made(Node::subscription_to_any);
        /// The state of the nodes.
        pub diagnostics: Subscription<DiagnosticArray> = "/diagnostics", qos(BURST);
        /// The log.
        pub log: Subscription<Log> = "/rosout", qos(BURST);
    }
}

/// The topics of a live view; `None` if it shows a bag.
pub(crate) struct LiveInputs(pub Option<Inputs>);

impl EndpointSet for LiveInputs {
    fn specs() -> Vec<EndpointSpec> {
        let mut specs = Inputs::specs();
        specs.extend(control::specs());
        specs
    }

    fn make(node: &Node) -> Result<Self, Error> {
        let bag: String = node.parameter("bag")?;
        bag.is_empty()
            .then(|| Inputs::make(node))
            .transpose()
            .map(Self)
    }
}

/// The topics by their names in this node, without the siblings.
pub(crate) fn topics(node: &Node, camera_topic: &str, is_live: bool) -> Result<Vec<InputTopic>> {
    let names = [
        (Topic::Camera, camera_topic),
        (Topic::Predicted, "predicted"),
        (Topic::Pictures, "predicted/image"),
        (Topic::Errors, "prediction_error"),
        (Topic::Action, "action"),
        (Topic::Chunk, "action_chunk"),
        (Topic::Goal, "goal/image"),
        (Topic::Plan, "plan"),
        (Topic::Markers, "markers"),
        (Topic::Outcome, "plan/image"),
        (Topic::Subgoals, "plan/subgoals/image"),
        (Topic::Candidates, "action_candidates"),
        (Topic::CandidatePictures, "candidates/image"),
        (Topic::Assessment, "assessment"),
        (Topic::Executor, "executor/status"),
        (Topic::Learner, "learner/status"),
        (Topic::Diagnostics, "/diagnostics"),
        (Topic::Log, "/rosout"),
    ];
    let input = |(topic, name): (Topic, &str)| {
        let name = node.resolve(name)?;
        Ok(InputTopic {
            topic,
            name,
            publishers: is_live.then_some(0),
        })
    };
    names.into_iter().map(input).collect()
}

impl Inputs {
    /// Follows a change of the graph: the transports of pictures, and the number of publishers.
    pub(crate) fn look(&mut self, publishers: &Publishers, shared: &Shared) -> Result<()> {
        let pictures = [
            (Topic::Camera, &mut self.camera),
            (Topic::Pictures, &mut self.pictures),
            (Topic::Outcome, &mut self.outcomes),
            (Topic::Subgoals, &mut self.subgoals),
            (Topic::CandidatePictures, &mut self.candidate_pictures),
            (Topic::Goal, &mut self.goal_pictures),
        ];
        let mut of_pictures = Vec::new();
        for (topic, subscription) in pictures {
            subscription.look(publishers)?;
            of_pictures.push((topic, subscription.publishers(publishers)));
        }
        for heard in &mut shared.known().inputs {
            let picture = of_pictures.iter().find(|(topic, _)| *topic == heard.topic);
            // A topic without publishers has no entry.
            let own = || publishers.get(&heard.name).copied().unwrap_or(0);
            heard.publishers = Some(picture.map_or_else(own, |(_, number)| *number));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_ros::Reliability;

    #[test]
    fn latched_topics_are_received_reliably() {
        let specs = Inputs::specs();
        for latched in [
            "/tf_static",
            "predicted/fit",
            "goal",
            "goal/image",
            "goal/image/compressed",
            "executor/status",
            "learner/status",
        ] {
            let spec = specs.iter().find(|spec| spec.name == latched).unwrap();
            let qos = spec.qos.unwrap();
            assert_eq!(qos.reliability, Reliability::Reliable, "{latched}");
        }
    }
}
