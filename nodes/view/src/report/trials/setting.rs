//! The nodes of an episode: the arm, the planner, the executor.

use anyhow::{Context as _, Result, bail, ensure};
use wm_msgs::{
    std_srvs::{SetBool, SetBoolRequest},
    wm_msgs::{Reset, ResetRequest},
};
use wm_ros::{Client, RemoteParameters};

wm_ros::endpoints! {
    /// The services of these nodes.
    pub(crate) struct Setting {
        /// Begins a task of the arm.
        table: Client<Reset> = "sim_arm/reset";
        /// Sets the arm's task.
        parameters: RemoteParameters = "sim_arm";
        /// Forgets the last episode.
        planner: Client<Reset> = "planner/reset";
        /// Arms the executor for an episode, and disarms it after.
        executor: Client<SetBool> = "executor/arm";
    }
}

impl Setting {
    /// Waits until all services exist.
    pub(crate) async fn wait(&self) {
        self.table.wait_for_service().await;
        self.parameters.wait_for_service().await;
        self.planner.wait_for_service().await;
        self.executor.wait_for_service().await;
    }

    /// Makes the arm begin a task. Disarm the executor first.
    ///
    /// # Errors
    /// The task is unknown, or a node does not reply.
    pub(crate) async fn lay(&self, task: &str, seed: u64) -> Result<()> {
        if let Err(reason) = self.parameters.set("task", task.to_owned()).await? {
            bail!("sim_arm does not take the task {task}: {reason}");
        }
        reset(&self.table, "sim_arm", seed).await
    }

    /// Resets the planner.
    ///
    /// # Errors
    /// It does not reply, or refuses.
    pub(crate) async fn plan_anew(&self, seed: u64) -> Result<()> {
        reset(&self.planner, "planner", seed).await
    }

    /// Arms or disarms the executor, and waits for a moving arm to stop.
    ///
    /// # Errors
    /// The executor does not reply, or refuses for another reason.
    pub(crate) async fn arm(&self, is_armed: bool) -> Result<()> {
        for _ in 0..MOST_REQUESTS {
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

/// The most requests while the arm stops: each reply takes a turn of the executor's loop.
const MOST_REQUESTS: usize = 10_000;

async fn reset(client: &Client<Reset>, name: &str, seed: u64) -> Result<()> {
    let request = ResetRequest {
        seed,
        keep_seed: false,
    };
    let answer = client.call(&request).await.context(name.to_owned())?;
    ensure!(answer.success, "{name}: {}", answer.message);
    Ok(())
}
