//! The learner beside the nodes that predict: it records, trains a round, and lets them change to another model while they
//! work. The rounds are short, so their models are no better.

use std::{fs, path::Path, time::Duration};

use rustix::process::Signal;
use wm_msgs::wm_msgs::{LearnerStatus, Prediction, UseModel, UseModelRequest};
use wm_ros::{Node, Qos, Subscription};

use crate::harness::{
    Process, fresh_domain, join, looping_player, root, soon, wait_for_publishers, wait_until,
    whole_suite, wm, wm_node,
};

/// Far longer than a round of some steps; only ends a hanging test.
const PATIENCE: Duration = Duration::from_secs(600);

/// The learner with rounds of a few steps; `None` if the trainings are not built.
fn learner(domain: u16, output: &Path) -> Option<Process> {
    let help = wm(domain, &["train", "round", "--help"]).output();
    if !help.expect("wm runs").status.success() {
        eprintln!("skipped: wm train is not built");
        return None;
    }
    let output = format!("output:={}", output.display());
    let parameters = [
        &output,
        "bag_seconds:=5.0",
        "first_seconds:=9.5",
        "more_seconds:=600.0",
        "test_bags:=1",
        // a tenth of them in the first round
        "transition_steps:=400",
        "idm_steps:=10",
        "threads:=1",
        "recipe:=[transition.checkpoint_seconds=1]",
        "min_free:=0.0",
        // of a busy computer
        "max_temperature:=200.0",
    ];
    Some(Process::start(wm_node(domain, "learner", &parameters)))
}

async fn until(
    statuses: &mut Subscription<LearnerStatus>,
    is_so: impl Fn(&LearnerStatus) -> bool,
) -> LearnerStatus {
    let wait = async {
        loop {
            let status = statuses.recv().await.expect("the node runs").message;
            if is_so(&status) {
                break status;
            }
        }
    };
    let status = tokio::time::timeout(PATIENCE, wait).await;
    status.expect("a status of the learner")
}

fn statuses(node: &Node) -> Subscription<LearnerStatus> {
    let topic = "/wm/learner/status";
    node.subscription(topic, Qos::latched(1))
        .expect("a subscription")
}

#[test]
fn learner_trains_and_the_nodes_change_their_model() {
    let _alone = whole_suite();
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    runtime.block_on(learn_and_change());
}

async fn learn_and_change() {
    let domain = fresh_domain();
    let folder = tempfile::tempdir().expect("a temporary directory");
    let output = folder.path().join("learner");
    let Some(first) = learner(domain, &output) else {
        return;
    };
    let follow = ["follow_model:=true"];
    let _nodes = [
        looping_player(domain),
        Process::start(wm_node(domain, "encoder", &follow)),
        Process::start(wm_node(domain, "predictor", &follow)),
    ];
    let (_context, node) = join(domain, "observer");
    let mut states = statuses(&node);

    // It is killed in the middle of a round.
    let is_training = |status: &LearnerStatus| status.step >= 1;
    let begun = until(&mut states, is_training).await;
    assert_eq!((begun.round, begun.rounds.len()), (1, 0));
    assert_eq!(begun.steps, 40, "a tenth of the most: {begun:?}");
    let plan = output.join("models/round-0001/round.json");
    let planned = fs::read_to_string(&plan).expect("a plan");
    first.signal(Signal::KILL);
    drop((first, states));

    // The same round goes on after a restart.
    let _second = learner(domain, &output);
    let mut states = statuses(&node);
    let ended = until(&mut states, |status| !status.rounds.is_empty()).await;
    let round = &ended.rounds[0];
    assert_eq!(round.round, 1);
    assert!(round.ratio.is_finite() && round.ratio > 0.0, "{round:?}");
    assert!(
        round.ratio_before > 0.0 && round.ratio_before < 1.0,
        "tiny knows the bag: {round:?}"
    );
    assert_eq!(fs::read_to_string(&plan).expect("the plan"), planned);

    // Another model, named by the service.
    let other = folder.path().join("other");
    fs::create_dir(&other).expect("a folder");
    for file in ["autoencoder.safetensors", "transition.safetensors"] {
        let own = root().join("world-model/model/weights/tiny").join(file);
        fs::copy(own, other.join(file)).expect("a copy");
    }
    wait_for_publishers(domain, &["/wm/predicted"]);
    let mut predictions = node
        .subscription::<Prediction>("/wm/predicted", Qos::reliable(16))
        .expect("a subscription");
    let before = soon("a prediction", predictions.recv()).await;
    let before = before.expect("the node runs").message;
    // A call may go to the killed learner alone, whose lease lasts.
    let topic = "/wm/learner/status";
    wait_until("one learner is left", PATIENCE, || {
        let seen = node.topics().into_iter().find(|seen| seen.name == topic);
        seen.is_some_and(|seen| seen.publishers.len() == 1)
    });
    let client = node
        .client::<UseModel>("/wm/learner/use_model")
        .expect("a client");
    soon("the service", client.wait_for_service()).await;
    let use_model = async |model: &Path| {
        let model = model.display().to_string();
        let request = UseModelRequest { model };
        let response = soon("a response", client.call(&request)).await;
        response.expect("a response")
    };
    let missing = use_model(&folder.path().join("missing")).await;
    assert!(
        !missing.success && missing.message.contains("is no model"),
        "{missing:?}"
    );
    let used = use_model(&other).await;
    assert!(used.success, "{used:?}");
    let changed = async {
        loop {
            let message = predictions.recv().await.expect("a prediction").message;
            if message.epoch > before.epoch && message.model != before.model {
                break message;
            }
        }
    };
    let changed = tokio::time::timeout(PATIENCE, changed)
        .await
        .expect("a prediction of the other model");
    assert!(changed.model.contains("other"), "{}", changed.model);
}
