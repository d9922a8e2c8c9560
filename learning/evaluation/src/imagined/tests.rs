#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use wm_sim::{GoalKind, ScriptedPolicy};
use wm_zoo::ModelFolder;

use super::{
    candidate::{Candidate, NamedCommand},
    findings::{Findings, RunInfo},
    start::{Outcome, Setup, Start},
};
use crate::closed_loop::model::Model;

/// tiny was not trained on it.
const SEED: u64 = 5_000_000;

/// Runs the candidates on reaching, with the bundled model.
fn run(candidates: &[Candidate]) -> anyhow::Result<Start> {
    let folder = ModelFolder::open("tiny").unwrap();
    let model = Model::load(&folder).unwrap();
    let probe = folder.probe().unwrap().unwrap();
    let setup = Setup {
        task: GoalKind::Reach,
        candidates,
        model: &model,
        probe: &probe,
        patience: 1.5,
    };
    let start = setup.run(SEED)?;
    assert!(start.steps >= 10 && start.steps + 2 <= probe.max_frames());
    Ok(start)
}

#[test]
fn policy_result_does_not_depend_on_other_policies() {
    let scripted = Candidate::Scripted;
    let both = [ScriptedPolicy::Hold, ScriptedPolicy::Oracle].map(scripted);
    let both = run(&both).unwrap();
    let alone = run(&[scripted(ScriptedPolicy::Oracle)]).unwrap();
    assert_eq!(alone.outcomes[0], both.outcomes[1]);
    let [hold, oracle] = [both.outcomes[0], both.outcomes[1]];
    assert!(oracle.executed && oracle.followed && !hold.executed && !hold.followed);
    assert!(oracle.seen > hold.seen, "{both:?}");
    assert!(oracle.imagined > hold.imagined, "{both:?}");
}

#[test]
fn program_acts_on_the_arm_and_in_imagination() {
    let script = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../examples/imagined_policy/policy.py"
    );
    let program = |options: &str| {
        let named = format!("down=python3 '{script}' {options}").parse();
        let limit = std::time::Duration::from_secs(60);
        Candidate::program(&named.unwrap(), limit).unwrap()
    };
    let hold = Candidate::Scripted(ScriptedPolicy::Hold);
    let both = run(&[program("--speed 0"), hold]).unwrap();
    let [still, hold] = [both.outcomes[0], both.outcomes[1]];
    // It opens and closes the gripper where it stands.
    assert!(
        (still.distance_m - hold.distance_m).abs() < 1e-9,
        "{both:?}"
    );
    let moving = run(&[program("--down 1 --speed 0.02")]).unwrap().outcomes[0];
    assert_ne!(moving.distance_m, still.distance_m);
    assert_ne!(moving.imagined, still.imagined);
    let error = run(&[program("--no-such-option")]).unwrap_err();
    let error = format!("{error:#}");
    assert!(error.contains("down on the arm"), "{error}");
}

#[test]
fn commands_without_a_name_are_rejected() {
    for wrong in ["", "policy.py", "=policy.py", "name= "] {
        let error = wrong.parse::<NamedCommand>().unwrap_err().to_string();
        assert!(error.contains("NAME=COMMAND"), "{error}");
    }
}

fn run_info() -> RunInfo {
    RunInfo {
        task: "reach".into(),
        model: "tiny".into(),
        model_hash: "00".into(),
        seed: 1,
        starts: 8,
        patience: 1.5,
    }
}

/// Starts of five policies; the nth reaches the goal in n of four; `imagined` is its probability.
fn starts(imagined: impl Fn(u8) -> f32) -> Vec<Start> {
    let start = |seed: u64| Start {
        seed,
        steps: 10,
        outcomes: (0..5)
            .map(|policy| Outcome {
                executed: seed % 4 < u64::from(policy),
                followed: true,
                distance_m: 0.01,
                seen: 0.5,
                imagined: imagined(policy),
            })
            .collect(),
    };
    (0..8).map(start).collect()
}

#[test]
fn findings_rank_policies() {
    let policies = ScriptedPolicy::ALL[..5].iter();
    let policies: Vec<_> = policies
        .map(|policy| Candidate::Scripted(*policy))
        .collect();
    let json = |imagined: fn(u8) -> f32| -> serde_json::Value {
        let found = Findings::of(run_info(), &policies, &starts(imagined)).unwrap();
        assert!(found.to_string().contains("none: all policies"), "{found}");
        serde_json::from_str(&found.to_json().unwrap()).unwrap()
    };
    let agreement = |json: &serde_json::Value, score: &str, success: &str| {
        let agreements = json["agreements"].as_array().unwrap().iter();
        let mut found = agreements.filter(|a| a["score"] == score && a["success"] == success);
        found.next().unwrap().clone()
    };
    let line = json(|policy| f32::from(policy) / 8.0);
    let found = agreement(&line, "imagined", "executed");
    assert!(found["pearson"]["value"].as_f64().unwrap() > 1.0 - 1e-9);
    assert!(
        found["pearson"]["interval_of_policies"][0]
            .as_f64()
            .unwrap()
            > 0.9
    );
    let low = found["pearson"]["interval"][0].as_f64().unwrap();
    assert!(
        low > 0.5 && low < 1.0 - 1e-9,
        "starts change the rates: {low}"
    );
    // Between starts the arm's success differs, the probability does not.
    assert_eq!(line["policies"][2]["executed"]["rate"], 0.5);
    assert_eq!(line["policies"][2]["imagined"]["probability"], 0.25);
    assert_eq!(line["policies"][2]["imagined"]["successes"]["rate"], 0.0);
    let same = agreement(&line, "imagined", "followed");
    assert!(same["pearson"].is_null() && same["spearman"].is_null());

    // The order is right, the amount is not.
    let bent = json(|policy| {
        if policy == 4 {
            1.0
        } else {
            f32::from(policy) / 100.0
        }
    });
    let found = agreement(&bent, "imagined", "executed");
    assert!(found["spearman"]["value"].as_f64().unwrap() > 1.0 - 1e-9);
    assert!(found["pearson"]["value"].as_f64().unwrap() < 0.85);
    let wrong = json(|policy| 1.0 - f32::from(policy) / 8.0);
    let found = agreement(&wrong, "imagined", "executed");
    assert!(found["spearman"]["value"].as_f64().unwrap() < -1.0 + 1e-9);
}
