//! An action's two ends over DDS on loopback, in two participants, as two processes would have them.

use crate::participants::{contexts, node, soon};
use std::cell::RefCell;
use wm_msgs::{
    action_msgs::{CancelGoalResponse, GoalInfo, GoalStatusArray},
    lifecycle_msgs::{ChangeState, ChangeStateRequest, Transition},
    sensor_msgs::Image,
    wm_msgs::{
        Goal,
        action::{Plan, PlanFeedback, PlanGoal, PlanResult},
    },
};
use wm_ros::{
    ActionClient, ActionServer, ClientGoal, Context, Error, GoalStatus, Lifecycle, Managed, Node,
    Qos, Role, ServerGoal,
};

/// Two nodes, and the two ends of an action between them that know each other.
struct Pair {
    robot: Node,
    server: ActionServer<Plan>,
    client: ActionClient<Plan>,
    _contexts: [Context; 2],
}

impl Pair {
    async fn new() -> Self {
        let contexts = contexts();
        let planner = node(&contexts[0], "planner", "");
        let robot = node(&contexts[1], "robot", "");
        let server = planner.action_server::<Plan>("plan_to").unwrap();
        let client = robot.action_client::<Plan>("plan_to").unwrap();
        soon("connecting", client.wait_for_server()).await;
        // what is published before the publisher knows of the subscription is lost, as any volatile topic's
        let mut changes = planner.graph_changes();
        let feedback = "plan_to/_action/feedback";
        soon("connecting", async {
            while planner.count_subscribers(feedback).unwrap() == 0 {
                changes.changed().await.unwrap();
            }
        })
        .await;
        Self {
            robot,
            server,
            client,
            _contexts: contexts,
        }
    }

    /// Sends a goal, which the server takes on.
    async fn accepted(&mut self, goal: PlanGoal) -> (ServerGoal<Plan>, ClientGoal<Plan>) {
        let taken = async { self.server.recv().await.unwrap().accept().unwrap() };
        let (taken, sent) = tokio::join!(
            soon("a goal", taken),
            soon("an answer", self.client.send(&goal))
        );
        (taken, sent.unwrap().unwrap())
    }
}

fn words(text: &str) -> PlanGoal {
    PlanGoal {
        goal: Goal {
            instruction: text.to_owned(),
            ..Goal::default()
        },
        ..PlanGoal::default()
    }
}

fn result(message: &str) -> PlanResult {
    PlanResult {
        message: message.to_owned(),
        ..PlanResult::default()
    }
}

async fn status(goal: &ClientGoal<Plan>, wanted: GoalStatus) {
    let mut status = goal.status();
    let wait = status.wait_for(|status| *status == Some(wanted));
    soon(&format!("the status {wanted}"), wait).await.unwrap();
}

#[tokio::test(flavor = "current_thread")]
async fn a_goal_is_taken_on_followed_and_achieved() {
    let mut pair = Pair::new().await;
    let (taken, sent) = pair.accepted(words("reach")).await;
    assert_eq!(taken.goal, words("reach"));
    assert_eq!(taken.id(), sent.id());
    assert!(sent.accepted().to_nanos() > 0);
    status(&sent, GoalStatus::Executing).await;
    for iteration in 0..3 {
        let feedback = PlanFeedback {
            iteration,
            terms: vec!["goal".into()],
            term_costs: vec![0.5],
            ..PlanFeedback::default()
        };
        taken.publish_feedback(&feedback).unwrap();
        let heard = soon("feedback", sent.feedback()).await.unwrap();
        assert_eq!(heard, feedback);
    }
    assert!(!taken.is_canceling());
    // one asks before the end, one after
    let (early, ()) = tokio::join!(soon("the result", sent.result()), async {
        taken.succeed(result("there")).unwrap();
    });
    let expected = (GoalStatus::Succeeded, result("there"));
    assert_eq!(early.unwrap(), expected);
    status(&sent, GoalStatus::Succeeded).await;
    let late = soon("the result again", sent.result()).await;
    assert_eq!(late.unwrap(), expected);
    assert!(!soon("an answer", sent.cancel()).await.unwrap());
}

#[tokio::test(flavor = "current_thread")]
async fn goals_are_rejected_canceled_and_given_up() {
    let mut pair = Pair::new().await;
    let (wishes, reject) = (words("too hard"), async {
        pair.server.recv().await.unwrap().reject();
    });
    let (answer, ()) = tokio::join!(
        soon("an answer", pair.client.send(&wishes)),
        soon("a goal", reject)
    );
    assert!(answer.unwrap().is_none());

    let (first, of_first) = pair.accepted(words("first")).await;
    let (second, of_second) = pair.accepted(words("second")).await;
    assert_ne!(first.id(), second.id());
    assert!(soon("an answer", of_second.cancel()).await.unwrap());
    soon("the request", second.canceling()).await;
    assert!(!first.is_canceling());
    status(&of_second, GoalStatus::Canceling).await;
    second.cancel(result("as you like")).unwrap();
    let ended = soon("the result", of_second.result()).await.unwrap();
    assert_eq!(ended, (GoalStatus::Canceled, result("as you like")));

    // who forgets a goal gives it up
    drop(first);
    let ended = soon("the result", of_first.result()).await.unwrap();
    assert_eq!(ended, (GoalStatus::Aborted, PlanResult::default()));

    // all of them, those that wait included
    let deferred = async { pair.server.recv().await.unwrap().defer().unwrap() };
    let wishes = words("third");
    let (third, of_third) = tokio::join!(
        soon("a goal", deferred),
        soon("an answer", pair.client.send(&wishes))
    );
    let of_third = of_third.unwrap().unwrap();
    status(&of_third, GoalStatus::Accepted).await;
    let response = soon("an answer", pair.client.cancel(GoalInfo::default())).await;
    let CancelGoalResponse {
        return_code,
        goals_canceling,
    } = response.unwrap();
    assert_eq!(return_code, CancelGoalResponse::ERROR_NONE);
    let canceling: Vec<_> = goals_canceling.iter().map(|info| info.goal_id).collect();
    assert_eq!(canceling, [third.id().into()]);
    assert_eq!(goals_canceling[0].stamp, of_third.accepted());
    third.execute();
    assert!(third.is_canceling());
    third.abort(result("no")).unwrap();
    let ended = soon("the result", of_third.result()).await.unwrap();
    assert_eq!(ended, (GoalStatus::Aborted, result("no")));
}

/// Two pictures are more than one datagram.
#[tokio::test(flavor = "current_thread")]
async fn a_goal_may_be_pictures() {
    let mut pair = Pair::new().await;
    let image = Image {
        height: 256,
        width: 256,
        encoding: "rgb8".into(),
        step: 768,
        data: (0..256 * 768).map(|byte| byte as u8).collect(),
        ..Image::default()
    };
    let mut goal = words("look like this");
    goal.goal.images = vec![image.clone(), image];
    let (taken, _sent) = pair.accepted(goal.clone()).await;
    assert_eq!(taken.goal, goal);
}

#[tokio::test(flavor = "current_thread")]
async fn an_action_is_in_the_graph_as_ros_has_it() {
    let mut pair = Pair::new().await;
    let mut there: Vec<_> = pair
        .robot
        .remote_endpoints()
        .into_iter()
        .filter(|endpoint| endpoint.name.contains("/_action/"))
        .map(|endpoint| (endpoint.name, endpoint.role, endpoint.type_name))
        .collect();
    there.sort();
    let expected = [
        ("cancel_goal", Role::Server, "action_msgs/srv/CancelGoal"),
        (
            "feedback",
            Role::Publisher,
            "wm_msgs/action/Plan_FeedbackMessage",
        ),
        ("get_result", Role::Server, "wm_msgs/action/Plan_GetResult"),
        ("send_goal", Role::Server, "wm_msgs/action/Plan_SendGoal"),
        ("status", Role::Publisher, "action_msgs/msg/GoalStatusArray"),
    ];
    let expected = expected.map(|(part, role, type_name)| {
        let name = format!("/wm/plan_to/_action/{part}");
        (name, role, type_name.to_owned())
    });
    assert_eq!(there, expected);

    // who comes late hears how far the goals are
    let (taken, _sent) = pair.accepted(words("reach")).await;
    let mut statuses = pair
        .robot
        .subscription::<GoalStatusArray>("plan_to/_action/status", Qos::latched(1))
        .unwrap();
    let heard = soon("the status", statuses.recv()).await.unwrap().message;
    let [only] = heard.status_list[..] else {
        panic!("{heard:?}")
    };
    assert_eq!(only.goal_info.goal_id, taken.id().into());
}

/// Takes goals on while it is active, and notes how many.
struct Planner<'a>(&'a RefCell<u32>);

impl Managed for Planner<'_> {
    type Configured = ActionServer<Plan>;
    type Active = ();
    type Error = Error;

    async fn configure(&self, node: &Node) -> Result<ActionServer<Plan>, Error> {
        node.action_server("plan_to")
    }

    fn activate(&self, _: &ActionServer<Plan>) -> Result<(), Error> {
        Ok(())
    }

    async fn run(&self, server: &mut ActionServer<Plan>, (): &mut ()) -> Result<(), Error> {
        let mut held = Vec::new();
        while let Some(request) = server.recv().await {
            held.push(request.accept()?);
            *self.0.borrow_mut() += 1;
        }
        Ok(())
    }
}

#[tokio::test(flavor = "current_thread")]
async fn inactive_node_rejects_goals_and_aborts_those_under_way() {
    let [here, there] = contexts();
    let planner = node(&here, "planner", "--ros-args -p autostart:=false");
    let lifecycle = Lifecycle::new(&planner).unwrap();
    let robot = node(&there, "robot", "");
    let changes = robot.client::<ChangeState>("planner/change_state").unwrap();
    let client = robot.action_client::<Plan>("plan_to").unwrap();
    let change = async |label: &str| {
        let transition = Transition {
            id: 0,
            label: label.to_owned(),
        };
        let answer = changes.call(&ChangeStateRequest { transition }).await;
        assert!(answer.unwrap().success, "{label}");
    };
    let goals = RefCell::new(0);
    let told = async {
        changes.wait_for_service().await;
        change("configure").await;
        client.wait_for_server().await;
        for round in 0..2 {
            assert!(client.send(&words("early")).await.unwrap().is_none());
            change("activate").await;
            let goal = client.send(&words("now")).await.unwrap().unwrap();
            assert_eq!(*goals.borrow(), round + 1);
            change("deactivate").await;
            let (status, _) = goal.result().await.unwrap();
            assert_eq!(status, GoalStatus::Aborted);
        }
        change("shutdown").await;
    };
    let both = async { tokio::join!(lifecycle.run(Planner(&goals)), told) };
    let (ended, ()) = soon("all of it", both).await;
    ended.unwrap();
}

#[tokio::test(flavor = "current_thread")]
async fn an_action_goes_where_it_is_remapped_to() {
    let [here] = contexts();
    let line = "--ros-args -r __ns:=/arm -r plan_to:=reach -r /arm/reach/_action/status:=/status";
    let planner = node(&here, "mapped", line);
    let server = planner.action_server::<Plan>("plan_to").unwrap();
    assert_eq!(server.name(), "/arm/reach");
    let topics: Vec<String> = planner
        .topics()
        .into_iter()
        .map(|topic| topic.name)
        .collect();
    assert!(topics.contains(&"/arm/reach/_action/feedback".to_owned()));
    assert!(topics.contains(&"/status".to_owned()), "{topics:?}");
}
