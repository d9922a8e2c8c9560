//! The nodes that an episode takes: the arm, the planner, the executor.

use anyhow::{Context as _, Result, bail, ensure};
use wm_msgs::{
    std_srvs::{SetBool, SetBoolRequest},
    wm_msgs::{Reset, ResetRequest},
};
use wm_ros::{Client, Node, RemoteParameters};
use wm_sim::GoalKind;

/// The services of these nodes.
pub struct Setting {
    table: Client<Reset>,
    parameters: RemoteParameters,
    planner: Client<Reset>,
    executor: Client<SetBool>,
}

impl Setting {
    /// Those in the namespace of `node`.
    ///
    /// # Errors
    /// The graph refuses.
    pub fn new(node: &Node) -> Result<Self> {
        Ok(Self {
            table: node.client("sim_arm/reset")?,
            parameters: RemoteParameters::new(node, "sim_arm")?,
            planner: node.client("planner/reset")?,
            executor: node.client("executor/arm")?,
        })
    }

    /// Waits until all of them are there.
    pub async fn wait(&self) {
        self.table.wait_for_service().await;
        self.parameters.wait_for_service().await;
        self.planner.wait_for_service().await;
        self.executor.wait_for_service().await;
    }

    /// Has the arm begin a task. The executor is to be disarmed.
    ///
    /// # Errors
    /// There is no such task, or a node does not answer.
    pub async fn lay(&self, task: GoalKind, seed: u64) -> Result<()> {
        let name = task.name().to_owned();
        if let Err(reason) = self.parameters.set("task", name).await? {
            bail!("sim_arm does not take the task {task}: {reason}");
        }
        reset(&self.table, "sim_arm", seed).await
    }

    /// Has the planner begin anew.
    ///
    /// # Errors
    /// It does not answer, or refuses.
    pub async fn plan_anew(&self, seed: u64) -> Result<()> {
        reset(&self.planner, "planner", seed).await
    }

    /// Arms the executor, or disarms it. An arm that still comes to a stop is waited for.
    ///
    /// # Errors
    /// It does not answer, or refuses for another reason.
    pub async fn arm(&self, is_armed: bool) -> Result<()> {
        for _ in 0..MOST_ASKED {
            let answer = self.executor.call(&SetBoolRequest { data: is_armed }).await;
            let answer = answer.context("executor")?;
            if answer.success {
                return Ok(());
            }
            ensure!(
                answer.message.contains("stop: call again"),
                "executor: {}",
                answer.message
            );
        }
        bail!("the executor does not come to a stop")
    }
}

/// How often the executor is asked while it comes to a stop: each answer takes a turn of its loop.
const MOST_ASKED: usize = 10_000;

async fn reset(client: &Client<Reset>, name: &str, seed: u64) -> Result<()> {
    let request = ResetRequest {
        seed,
        keep_seed: false,
    };
    let answer = client.call(&request).await.context(name.to_owned())?;
    ensure!(answer.success, "{name}: {}", answer.message);
    Ok(())
}
