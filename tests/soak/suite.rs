//! The arm in this process, and the suite's processes.

use std::{
    cell::RefCell,
    collections::BTreeMap,
    fs::File,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread::JoinHandle,
    time::Duration,
};

use rustix::process::{Pid, Signal};
use wm_msgs::{
    std_msgs::Bool,
    std_srvs::{SetBool, SetBoolRequest, Trigger, TriggerRequest},
    wm_msgs::{Reset, ResetRequest},
};
use wm_robot_nodes::sim_arm;
use wm_ros::{Client, Context, Environment, Middleware, Node, NodeArgs, Publisher, Qos, Reach};

use crate::middle::{TRUE_ACTION, TRUE_CAMERA, TRUE_POSE};

/// The processes.
const NODES: [&str; 3] = ["encoder", "planner", "executor"];
/// The longest duration of a call: its server may have ended.
const CALL: Duration = Duration::from_secs(2);

/// The simulated arm, in this process so that a cut hides none of its motion.
pub struct Arm {
    context: Context,
    node: Node,
    thread: JoinHandle<()>,
}

impl Arm {
    pub fn start(domain_id: u16) -> Self {
        let reach = Reach::Localhost;
        let context = Context::new(&Environment {
            domain_id,
            reach,
            middleware: Middleware::from_env().expect("a middleware of this build"),
        })
        .expect("a context");
        let words = format!(
            "--ros-args -p image_transport:=raw -p goal_period:=0.4 -r /camera/image_raw:={TRUE_CAMERA} \
             -r ee_pose:={TRUE_POSE} -r action:={TRUE_ACTION}"
        );
        let args = NodeArgs::parse(words.split_whitespace()).expect("arguments");
        let of_thread = context.clone();
        let thread = std::thread::spawn(move || {
            let of_arm = Node::new(&of_thread, "sim_arm", wm_ros::NAMESPACE, &args);
            let of_arm = of_arm.expect("a node");
            let runtime = tokio::runtime::Builder::new_current_thread()
                .enable_all()
                .build();
            runtime
                .expect("a runtime")
                .block_on((sim_arm::NODE.body)(of_arm))
                .expect("the arm");
        });
        let args = NodeArgs::parse(std::iter::empty::<&str>()).expect("no arguments");
        let node = Node::new(&context, "soak", wm_ros::NAMESPACE, &args).expect("a node");
        Self {
            context,
            node,
            thread,
        }
    }

    /// This program's node.
    pub fn node(&self) -> &Node {
        &self.node
    }

    pub fn end(self) {
        self.context.shutdown().trigger();
        self.thread.join().expect("the arm does not panic");
        drop(self.node);
        self.context.close();
    }
}

/// The person next to the arm.
pub struct World {
    node: Node,
    table: Client<Reset>,
    planner: Client<Reset>,
    arm: Client<SetBool>,
    reset: Client<Trigger>,
    emergency: RefCell<Option<Publisher<Bool>>>,
}

impl World {
    pub fn new(node: &Node) -> Self {
        let world = Self {
            table: node.client("sim_arm/reset").expect("a client"),
            planner: node.client("planner/reset").expect("a client"),
            arm: node.client("executor/arm").expect("a client"),
            reset: node.client("executor/reset").expect("a client"),
            emergency: RefCell::new(None),
            node: node.clone(),
        };
        world.make_emergency();
        world
    }

    /// Sets the table of a seed and arms the executor; repeats until that succeeds.
    pub async fn begin(&self, seed: u64) {
        while !self.armed(false).await {}
        let request = ResetRequest {
            seed,
            keep_seed: false,
        };
        loop {
            let laid = tokio::time::timeout(CALL, self.table.call(&request)).await;
            if matches!(laid, Ok(Ok(answer)) if answer.success) {
                break;
            }
        }
        loop {
            let planned = tokio::time::timeout(CALL, self.planner.call(&request)).await;
            if matches!(planned, Ok(Ok(answer)) if answer.success) {
                break;
            }
        }
        while !self.armed(true).await {}
    }

    async fn armed(&self, data: bool) -> bool {
        if data {
            let request = TriggerRequest::default();
            tokio::time::timeout(CALL, self.reset.call(&request))
                .await
                .ok();
        }
        let request = SetBoolRequest { data };
        let answer = tokio::time::timeout(CALL, self.arm.call(&request)).await;
        let is_done = matches!(answer, Ok(Ok(answer)) if answer.success);
        if !is_done {
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
        is_done
    }

    /// Presses or releases the emergency stop.
    pub fn press(&self, data: bool) {
        if let Some(emergency) = &*self.emergency.borrow() {
            emergency
                .publish(&Bool { data })
                .expect("the emergency stop");
        }
    }

    /// Removes the publisher of the emergency stop.
    pub fn drop_emergency(&self) {
        self.emergency.take();
    }

    /// Restores the publisher of the emergency stop.
    pub fn make_emergency(&self) {
        let publisher = self.node.publisher("emergency_stop", Qos::latched(1));
        let publisher: Publisher<Bool> = publisher.expect("a publisher");
        publisher.publish(&Bool { data: false }).expect("a message");
        self.emergency.replace(Some(publisher));
    }
}

/// The suite's processes.
pub struct Suite {
    domain_id: u16,
    logs: PathBuf,
    running: BTreeMap<&'static str, Child>,
}

impl Suite {
    /// Starts the processes; each logs to a file of its name.
    pub fn start(domain_id: u16, logs: &Path) -> Self {
        let mut suite = Self {
            domain_id,
            logs: logs.to_owned(),
            running: BTreeMap::new(),
        };
        for name in NODES {
            suite.start_node(name);
        }
        suite
    }

    fn start_node(&mut self, name: &'static str) {
        let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
        let parameters = format!("{root}/launch-configs/config/arm.yaml");
        let log = File::options()
            .create(true)
            .append(true)
            .open(self.logs.join(format!("{name}.log")))
            .expect("a log");
        let mut command = Command::new(env!("CARGO_BIN_EXE_wm"));
        command.args([name, "--ros-args", "--params-file", &parameters]);
        command.args(["-p", "use_sim_time:=true"]);
        if name == "planner" {
            command.args(["-p", "planner:=idm"]);
        }
        command
            .current_dir(root)
            .env("ROS_DOMAIN_ID", self.domain_id.to_string())
            .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
            .env_remove("ROS_LOCALHOST_ONLY")
            .env_remove("ROS_STATIC_PEERS")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log);
        let child = command.spawn().expect("a process");
        self.running.insert(name, child);
    }

    pub fn signal(&mut self, name: &str, signal: Signal) {
        if let Some(child) = self.running.get(name) {
            rustix::process::kill_process(Pid::from_child(child), signal).ok();
        }
    }

    /// Restarts ended processes, and returns their names.
    pub fn revive(&mut self) -> Vec<&'static str> {
        let mut dead = Vec::new();
        for (name, child) in &mut self.running {
            if !matches!(child.try_wait(), Ok(None)) {
                dead.push(*name);
            }
        }
        for name in dead.iter().copied() {
            self.start_node(name);
        }
        dead
    }

    /// Resident memory of each process \[MiB\], by name and number.
    pub fn resident(&self) -> BTreeMap<String, f64> {
        let pids = self.running.iter().map(|(name, child)| (*name, child.id()));
        let pids = pids.chain([("soak", std::process::id())]);
        let resident = pids.filter_map(|(name, pid)| {
            let status = std::fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
            let line = status
                .lines()
                .find_map(|line| line.strip_prefix("VmRSS:"))?;
            let kib: f64 = line.trim().strip_suffix(" kB")?.parse().ok()?;
            Some((format!("{name} {pid}"), kib / 1024.0))
        });
        resident.collect()
    }

    pub fn end(mut self) {
        for child in self.running.values() {
            rustix::process::kill_process(Pid::from_child(child), Signal::TERM).ok();
        }
        for child in self.running.values_mut() {
            child.wait().ok();
        }
    }
}

impl Drop for Suite {
    fn drop(&mut self) {
        for child in self.running.values_mut() {
            child.kill().ok();
            child.wait().ok();
        }
    }
}
