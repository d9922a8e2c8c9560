use serde_json::{Value, json};
use wm_zoo::ModelFolder;

use crate::Readers;

use super::{
    Bags, BuiltIn, PolicyArgs, of,
    server::{Server, says},
    threads,
};

#[test]
fn success_probes_judge_and_say_so() {
    let mut bags = Bags::new();
    let folder = ModelFolder::open("tiny").unwrap();
    let mut again = Readers::of_folder(&folder).unwrap().probes.remove(0);
    again.name = "success_again".into();
    bags.subject.readers.probes.push(again);
    let arguments = PolicyArgs {
        judges: Some("probes".into()),
        ..of(BuiltIn::Recorded)
    };
    let (_, section) = bags.run(&arguments, "records").unwrap();
    let metric = |name: &str| &section.metrics[&format!("policy.{name}")];
    for name in [
        "success_by_success",
        "success_by_success_again",
        "consensus_success",
    ] {
        assert_eq!(metric(name).value, metric("probe_success").value, "{name}");
        assert_eq!(metric(name).n, 4);
    }
    let why = section
        .absent
        .iter()
        .find(|a| a.metric == "policy.interaction_quality");
    assert!(why.unwrap().why.contains("success probes"));
    assert!(
        section
            .notes
            .iter()
            .any(|note| note.contains("not the paper's"))
    );

    bags.subject.readers.probes.clear();
    let error = bags.run(&arguments, "none").unwrap_err().to_string();
    assert!(error.contains("no success probe"), "{error}");
    let prompts = PolicyArgs {
        prompts: Some(bags.write("prompts.yaml", "")),
        ..arguments
    };
    let error = bags.run(&prompts, "none").unwrap_err().to_string();
    assert!(error.contains("--prompts"), "{error}");
}

/// Two judges follow the instruction; the third answers the opposite.
fn last_line(body: &Value) -> String {
    let text = body.to_string();
    if text.contains("Interaction_Quality") {
        let rating = |score: u8| json!({"score": score, "reason": "I am a test server."});
        let rubric = json!({
            "Interaction_Quality": rating(4),
            "Perspectivity": rating(5),
            "Instruction_Following": rating(2),
        });
        return rubric.to_string();
    }
    let is_red = text.contains("red box");
    let is_contrary = body["model"] == "contrary";
    format!("Final Score: {}", u8::from(is_red != is_contrary))
}

fn panel(server: &Server) -> String {
    let judges = ["contrary", "first", "second"].map(|model| {
        json!({"name": format!("the {model}"), "base_url": server.base_url(), "model": model})
    });
    json!({"judges": judges}).to_string()
}

#[test]
fn judges_answer_once_and_the_closest_two_decide() {
    let bags = Bags::new();
    let server = Server::new(|_, request| says(&last_line(&request.body)));
    let arguments = PolicyArgs {
        judges: Some(bags.write("judges.yaml", &panel(&server))),
        ..of(BuiltIn::Recorded)
    };
    let run =
        |folder: &str, count| threads(count).install(|| bags.run(&arguments, folder).unwrap());
    let (lines, section) = run("records", 1);
    // Four trials: three judges, and a rubric.
    assert_eq!(server.requests().len(), 4 * 4);
    let value = |name: &str| section.metrics[&format!("policy.{name}")].value;
    assert_eq!(value("success_by_the_first"), 0.5);
    assert_eq!(value("consensus_success"), 0.5);
    assert_eq!(value("mean_rater_success"), 0.5);
    assert_eq!(value("kappa_the_first_the_second"), 1.0);
    assert_eq!(value("kappa_the_contrary_the_first"), -1.0);
    assert_eq!(
        (value("interaction_quality"), value("perspectivity")),
        (4.0, 5.0)
    );
    let samples = &section.metrics["policy.consensus_success"].samples;
    assert_eq!((samples["bag_0"], samples["bag_1"]), (1.0, 0.0));
    assert!(
        section
            .notes
            .iter()
            .any(|note| note.contains("the first and the second, which agree most")),
        "{:?}",
        section.notes
    );

    // The records are lost, the answers are not.
    for entry in std::fs::read_dir(bags.dir.path().join("records")).unwrap() {
        let path = entry.unwrap().path();
        if path.is_file() {
            std::fs::remove_file(path).unwrap();
        }
    }
    assert_eq!(run("records", 2).0, lines);
    assert_eq!(server.requests().len(), 4 * 4);
    assert_eq!(run("other records", 2).0, lines);
    assert_eq!(server.requests().len(), 8 * 4);
}
