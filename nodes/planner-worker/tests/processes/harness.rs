//! Workers as processes, and a planning problem.

use std::{
    net::TcpListener,
    os::unix::process::CommandExt as _,
    process::{Child, Command, ExitStatus, Stdio},
    sync::LazyLock,
    time::{Duration, Instant},
};

use candle_core::{Device, Tensor};
use rustix::process::{Pid, Signal};
use wm_model::WorldModel;
use wm_planner::{
    ActionSize, Cem, CemSettings, Objective, PlannedActions, Planner as _, Problem, SearchSpace,
    Target, TransitionDynamics, WorkerPool, Workers,
};
use wm_planner_worker::{Identity, PlannerWorkers};
use wm_ros::zenoh::{Mode, NetworkArguments};
use wm_zoo::ModelFolder;

/// Far longer than any step of a test: it only ends a test that hangs.
pub const PATIENCE: Duration = Duration::from_secs(60);

const MODEL: &str = "tiny";

/// The embedded model.
pub fn model() -> &'static WorldModel {
    static LOADED: LazyLock<WorldModel> =
        LazyLock::new(|| ModelFolder::open(MODEL).unwrap().world_model().unwrap());
    &LOADED
}

/// A worker that ends with the test.
pub struct Process {
    child: Child,
    endpoint: String,
}

/// The endpoint of an ended worker.
pub struct Place(String);

impl Place {
    /// Starts another worker at this endpoint.
    pub fn worker(self) -> Process {
        worker_at(self.0)
    }
}

/// A worker on a free port.
pub fn worker() -> Process {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("tcp/{}", listener.local_addr().unwrap());
    drop(listener);
    worker_at(endpoint)
}

fn worker_at(endpoint: String) -> Process {
    let child = Command::new(env!("CARGO_BIN_EXE_wm-planner-worker"))
        .args(["--model", MODEL, "--listen", &endpoint])
        // Few threads, so that workers do not compete on machines with few cores.
        .env("RAYON_NUM_THREADS", "1")
        .stdin(Stdio::null())
        .process_group(0)
        .spawn()
        .unwrap();
    Process { child, endpoint }
}

impl Process {
    pub fn signal(&self, signal: Signal) {
        rustix::process::kill_process(Pid::from_child(&self.child), signal).unwrap();
    }

    /// Kills the process, as a power loss would; returns its endpoint.
    pub fn kill(mut self) -> Place {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
        Place(self.endpoint.clone())
    }

    /// Waits for the end of the process.
    pub fn finish(mut self) -> ExitStatus {
        let start = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(start.elapsed() < PATIENCE, "it does not end");
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if matches!(self.child.try_wait(), Ok(None)) {
            self.child.kill().ok();
            self.child.wait().ok();
        }
    }
}

/// The pool of a planner that knows these workers.
pub fn pool(workers: &[&Process], identity: Identity) -> PlannerWorkers {
    let network = NetworkArguments {
        mode: Some(Mode::Peer),
        connect: workers
            .iter()
            .map(|worker| worker.endpoint.clone())
            .collect(),
        ..NetworkArguments::default()
    };
    PlannerWorkers::connect(&network, identity).unwrap()
}

/// A goal, an observation, and the action bounds.
pub struct Scene {
    dynamics: TransitionDynamics<'static>,
    objective: Objective,
    space: SearchSpace,
}

const HORIZON: usize = 2;

impl Scene {
    pub fn new() -> Self {
        let model = model();
        let (height, width, channels) = model.space.shape();
        let values = model.encoding.action_dim();
        let context = waves(&[1, 2, height, width, channels], 0.3);
        let past = waves(&[1, values], 0.9);
        let sampler = &model.transition.config().sampler;
        let dynamics =
            TransitionDynamics::new(&model.transition, sampler, &context, Some(&past), 5).unwrap();
        let goal = waves(&[height, width, channels], 0.2);
        Self {
            dynamics,
            objective: Objective::of(Target::AllSteps(goal)).and(0.1, ActionSize),
            space: SearchSpace::bounded(&[(-1.0, 1.0); 3], values).unwrap(),
        }
    }

    pub fn share(&self, pool: &PlannerWorkers) -> Option<Box<dyn Workers>> {
        pool.share(&self.dynamics, &self.objective, &self.space, HORIZON)
    }

    /// Plans with 16 batches per iteration; calls `midway` after each.
    pub fn plan(
        &self,
        seed: u64,
        pool: Option<&PlannerWorkers>,
        midway: &mut dyn FnMut(),
    ) -> PlannedActions {
        let settings = CemSettings {
            population: 48,
            iterations: 2,
            elites: 6,
            ..CemSettings::default()
        };
        let mut dynamics = self.dynamics.clone();
        let mut lent = pool.and_then(|pool| self.share(pool));
        let mut problem = Problem {
            space: &self.space,
            dynamics: &mut dynamics,
            objective: &self.objective,
            horizon: HORIZON,
            batch: 3,
            proposals: Vec::new(),
            workers: lent.as_deref_mut(),
        };
        let cem = Cem::new(settings).unwrap();
        let planned = cem.plan(&mut problem, seed, &mut |_| {
            midway();
            false
        });
        planned.unwrap()
    }
}

fn waves(shape: &[usize], pitch: f32) -> Tensor {
    let count = shape.iter().product::<usize>();
    let values: Vec<f32> = (0..count).map(|i| (i as f32 * pitch).sin()).collect();
    Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
}
