//! Serves an action that counts: ten numbers a second for as long as the goal's duration says, each as feedback. A goal of
//! no duration is rejected.
//!
//! `cargo run -p wm_ros --example count -- /count`, and then for example
//! `ros2 action send_goal --feedback /count wm_msgs/action/Plan "{duration: {sec: 2}}"`

use std::time::Duration;
use tokio::{task::JoinSet, time::interval};
use wm_msgs::wm_msgs::action::{Plan, PlanFeedback, PlanResult};
use wm_ros::{ArgsError, Error, Node, NodeArgs, ServerGoal};

const PERIOD: Duration = Duration::from_millis(100);

fn main() -> Result<(), Error> {
    let args = NodeArgs::parse(std::env::args().skip(1))?;
    let [action] = args.rest() else {
        return Err(ArgsError::Rest(args.rest().to_vec()).into());
    };
    let action = action.clone();
    wm_ros::run(
        "count",
        "/",
        &args,
        async |node: Node| -> Result<(), Error> {
            node.seal_parameters()?;
            let mut server = node.action_server::<Plan>(&action)?;
            let mut counts = JoinSet::new();
            while let Some(request) = server.recv().await {
                if request.goal.duration.to_nanos() <= 0 {
                    request.reject();
                    continue;
                }
                counts.spawn(count(request.accept()?));
                while let Some(counted) = counts.try_join_next() {
                    if let Ok(Err(error)) = counted {
                        tracing::warn!("{error}");
                    }
                }
            }
            Ok(())
        },
    )
}

async fn count(goal: ServerGoal<Plan>) -> Result<(), Error> {
    let mut period = interval(PERIOD);
    let numbers = goal.goal.duration.to_nanos() / PERIOD.as_nanos() as i64;
    let result = |plans, message: &str| PlanResult {
        plans,
        message: message.to_owned(),
        ..PlanResult::default()
    };
    for number in 0..u32::try_from(numbers).unwrap_or(u32::MAX) {
        tokio::select! {
            biased;
            () = goal.canceling() => return goal.cancel(result(number, "canceled")),
            _ = period.tick() => goal.publish_feedback(&PlanFeedback {
                iteration: number,
                ..PlanFeedback::default()
            })?,
        }
    }
    goal.succeed(result(
        u32::try_from(numbers).unwrap_or(u32::MAX),
        "counted",
    ))
}
