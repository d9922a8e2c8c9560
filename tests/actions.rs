//! Actions between wm_ros and a real rclpy, each as client and as server.

use std::time::Duration;

use serde_json::{Value, json};
use tokio::task::JoinSet;
use wm_msgs::wm_msgs::action::{Plan, PlanFeedback, PlanGoal, PlanResult};
use wm_ros::{ActionServer, GoalStatus, ServerGoal};

use crate::harness::{Process, fresh_domain, join, peers, rclpy};

const PERIOD: Duration = Duration::from_millis(100);

/// Sends ten numbers per second, like the example `count` of wm_ros.
async fn count(goal: ServerGoal<Plan>) {
    let mut period = tokio::time::interval(PERIOD);
    let numbers = goal.goal.duration.to_nanos() / PERIOD.as_nanos() as i64;
    let result = |plans, message: &str| PlanResult {
        plans,
        message: message.to_owned(),
        ..PlanResult::default()
    };
    for iteration in 0..numbers as u32 {
        tokio::select! {
            () = goal.canceling() => return goal.cancel(result(iteration, "canceled")).unwrap(),
            _ = period.tick() => {}
        }
        let feedback = PlanFeedback {
            iteration,
            ..PlanFeedback::default()
        };
        goal.publish_feedback(&feedback).unwrap();
    }
    goal.succeed(result(numbers as u32, "counted")).unwrap();
}

async fn serve(mut server: ActionServer<Plan>) {
    let mut counts = JoinSet::new();
    while let Some(request) = server.recv().await {
        match request.goal.duration.to_nanos() {
            0 => request.reject(),
            _ => drop(counts.spawn(count(request.accept().unwrap()))),
        }
    }
}

#[test]
fn rclpy_sends_follows_and_cancels_goals() {
    let Some(peers) = peers() else { return };
    let domain = fresh_domain();
    let (context, node) = join(domain, "counter");
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    let server = node.action_server::<Plan>("count").expect("a server");
    let serving = runtime.spawn(serve(server));
    let args = ["--seconds", "20", "--server", "/wm/counter", "/wm/count"];
    let peer = Process::start(rclpy(&peers, domain, "actions.py", &args));
    let (status, stdout) = peer.finish(Duration::from_secs(120));
    assert!(status.success(), "actions.py: {status}");
    let answer: Value = serde_json::from_str(&stdout).expect("actions.py prints JSON");

    let typed = json!([["/wm/count", ["wm_msgs/action/Plan"]]]);
    for list in ["names", "served", "used"] {
        assert_eq!(answer[list], typed, "{list}: {answer}");
    }
    let counted = &answer["counted"];
    assert_eq!(
        counted["status"],
        GoalStatus::Succeeded.number(),
        "{answer}"
    );
    assert_eq!(counted["plans"], 10);
    assert_eq!(counted["message"], "counted");
    let heard = counted["feedback"].as_array().expect("a list");
    // the first may be published before the endpoints discover each other
    assert_eq!(heard.last(), Some(&json!(9)), "{answer}");
    assert!(heard.is_sorted_by_key(|number| number.as_u64()), "{answer}");

    let canceled = &answer["canceled"];
    assert_eq!(
        canceled["status"],
        GoalStatus::Canceled.number(),
        "{answer}"
    );
    assert_eq!(canceled["message"], "canceled");
    assert_eq!(canceled["return_code"], 0);
    assert_eq!(canceled["is_meant"], true);
    assert_eq!(canceled["again"], 3, "it has ended: {answer}");
    assert_eq!(answer["rejected"], true);
    assert_eq!(answer["unknown"], 2, "{answer}");
    assert_eq!(answer["statuses"], json!([4, 5]), "{answer}");

    context.shutdown().trigger();
    runtime.block_on(serving).expect("no panic");
}

#[test]
fn goals_of_rclpy_are_executed_and_canceled() {
    let Some(peers) = peers() else { return };
    let domain = fresh_domain();
    let (_context, node) = join(domain, "robot");
    let _server = Process::start(rclpy(&peers, domain, "action_server.py", &["/wm/count"]));
    let client = node.action_client::<Plan>("count").expect("a client");
    let goal = |tenths: i64| PlanGoal {
        duration: wm_msgs::builtin_interfaces::Duration::from_nanos(tenths * 100_000_000),
        ..PlanGoal::default()
    };
    let told = async {
        client.wait_for_server().await;
        assert!(client.send(&goal(0)).await.unwrap().is_none());

        let counting = client.send(&goal(5)).await.unwrap().expect("accepted");
        let (status, result) = counting.result().await.unwrap();
        assert_eq!((status, result.plans), (GoalStatus::Succeeded, 5));
        let mut status = counting.status();
        let ended = status.wait_for(|status| *status == Some(GoalStatus::Succeeded));
        ended.await.unwrap();

        let endless = client.send(&goal(1000)).await.unwrap().expect("accepted");
        let first = endless.feedback().await.expect("feedback").iteration;
        let next = endless.feedback().await.expect("feedback").iteration;
        assert_eq!(next, first + 1);
        assert!(endless.cancel().await.unwrap());
        let (status, result) = endless.result().await.unwrap();
        assert_eq!(status, GoalStatus::Canceled);
        assert_eq!(result.message, "canceled");
    };
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    let patience = Duration::from_secs(60);
    let told = async { tokio::time::timeout(patience, told).await };
    runtime.block_on(told).expect("it ends in time");
}
