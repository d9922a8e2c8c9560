//! Judges against a scripted local test server, whose answers say that it is one.

mod failures;
mod server;
mod setup;

use std::sync::Arc;

use base64::{Engine as _, engine::general_purpose::STANDARD};
use server::{Response, fails, says};
use setup::{Setup, entries, rollout};
use wm_evaluation::judges::{
    EndpointSettings, Error, FrameChoice, Panel, PanelSettings, Prompts, SuccessScore,
    endpoint::Clock,
};

#[test]
fn answer_is_requested_and_kept() {
    let setup = Setup::new(|_, _| says("Final Score: 1"));
    assert_eq!(setup.ask(3).unwrap(), Some(SuccessScore::Success));

    let requests = setup.server.requests();
    assert_eq!(requests.len(), 1);
    assert!(
        requests[0]
            .head
            .starts_with("POST /v1/chat/completions HTTP/1.1\r\n")
    );
    let content = requests[0].body["messages"][0]["content"]
        .as_array()
        .unwrap();
    let (text, pictures) = content.split_last().unwrap();
    assert!(
        text["text"]
            .as_str()
            .unwrap()
            .contains("Instruction: close oven")
    );
    let chosen = FrameChoice::default().indices(20);
    assert_eq!(pictures.len(), chosen.len());
    for (picture, index) in pictures.iter().zip(&chosen) {
        let url = picture["image_url"]["url"].as_str().unwrap();
        let bytes = STANDARD.decode(url.strip_prefix("data:image/png;base64,").unwrap());
        let seen = image::load_from_memory(&bytes.unwrap()).unwrap().to_rgb8();
        assert_eq!(seen, rollout(3).frames[*index]);
    }

    let entries = entries(&setup.path());
    assert_eq!(entries.len(), 1);
    assert_eq!(entries[0]["outcome"]["success"], 1.0);
    assert_eq!(entries[0]["trial"], 3);
    assert_eq!(entries[0]["stamp_ns"], 1_700_000_000_000_000_000_u64);
    assert_eq!(entries[0]["answers"][0]["usage"]["prompt_tokens"], 1000);
    let said = entries[0]["answers"][0]["text"].as_str().unwrap();
    assert!(said.starts_with("I am a test server, not a judge."));
    let kept = entries[0]["request"].to_string();
    assert!(
        kept.contains("sha256:") && !kept.contains("base64"),
        "{kept}"
    );
}

#[test]
fn rubric_is_requested_and_kept() {
    let rating = r#"{"score": 3, "reason": "I am a test server"}"#;
    let keys = wm_evaluation::judges::verdict::RUBRIC_KEYS;
    let fields = keys.map(|key| format!("\"{key}\": {rating}")).join(", ");
    let setup = Setup::new(move |_, _| says(&format!("```json\n{{{fields}}}\n```")));
    let mut record = setup.record();
    let judged = setup.judge().rubric(&rollout(0), &mut record).unwrap();
    assert_eq!(judged.verdict.unwrap().perspectivity.score, 3);
    assert!(!judged.from_record);
    let judged = setup.judge().rubric(&rollout(0), &mut record).unwrap();
    assert_eq!(judged.verdict.unwrap().perspectivity.score, 3);
    assert!(judged.from_record);
    assert_eq!(setup.requests(), 1);
}

#[test]
fn answer_without_score_is_repeated_with_another_seed() {
    let mut setup = Setup::new(|n, _| {
        says(if n < 2 {
            "I cannot say."
        } else {
            "Final Score: 1"
        })
    });
    setup.settings.reask_temperature = Some(0.5);
    assert_eq!(setup.ask(0).unwrap(), Some(SuccessScore::Success));
    let requests = setup.server.requests();
    let sent = |field: &str| {
        requests
            .iter()
            .map(|r| r.body[field].clone())
            .collect::<Vec<_>>()
    };
    assert_eq!(sent("seed"), [0, 1, 2]);
    assert_eq!(sent("temperature"), [0.0, 0.5, 0.5]);
    let entries = entries(&setup.path());
    assert_eq!(entries[0]["answers"].as_array().unwrap().len(), 3);
    assert!(
        entries[0]["answers"][0]["problem"]
            .as_str()
            .unwrap()
            .contains("Final Score: X")
    );
}

#[test]
fn answers_without_score_are_kept_and_counted() {
    let setup = Setup::new(|_, _| says("Final Score: 0.5"));
    assert_eq!(setup.ask(0).unwrap(), None);
    assert_eq!(setup.requests(), 3);
    assert_eq!(setup.record().tally("no_judge").unusable, 1);
    assert_eq!(setup.ask(0).unwrap(), None);
    assert_eq!(setup.requests(), 3);

    let mut partial = rollout(0);
    partial.partial_criteria = Some("half closed".to_owned());
    let judged = setup
        .judge()
        .success(&partial, &mut setup.record())
        .unwrap();
    assert_eq!(judged.verdict, Some(SuccessScore::Partial));
}

#[test]
fn cut_off_answer_is_unusable() {
    let setup = Setup::new(|_, _| match says("Final Score: 0") {
        Response::Whole(status, header, body) => {
            Response::Whole(status, header, body.replace("\"stop\"", "\"length\""))
        }
        other => other,
    });
    assert_eq!(setup.ask(0).unwrap(), None);
    let problem = entries(&setup.path())[0]["outcome"]["unusable"].to_string();
    assert!(problem.contains("max_tokens"), "{problem}");
}

#[test]
fn cost_limit_ends_a_run_and_keeps_its_answers() {
    let mut setup = Setup::new(|_, _| says("Final Score: 1"));
    setup.settings.price_per_million.input = 1000.0;
    // An answer costs 1: two fit, a third might not.
    setup.settings.max_cost = Some(2.5);
    setup.ask(0).unwrap();
    setup.ask(1).unwrap();
    for _ in 0..2 {
        let error = setup.ask(2).unwrap_err();
        assert!(
            matches!(
                error,
                Error::CostCap {
                    spent: 2.0,
                    next: 1.0,
                    ..
                }
            ),
            "{error}"
        );
    }
    assert_eq!((setup.requests(), entries(&setup.path()).len()), (2, 2));
    assert_eq!(setup.ask(1).unwrap(), Some(SuccessScore::Success));
}

#[test]
fn paid_answers_survive_an_error() {
    let setup = Setup::new(|n, _| match n {
        0 => says("I cannot say."),
        1 => fails(400, ""),
        _ => says("Final Score: 1"),
    });
    assert!(matches!(setup.ask(0), Err(Error::Rejected { .. })));
    assert!(entries(&setup.path())[0]["outcome"]["interrupted"].is_string());
    assert_eq!(setup.record().tally("no_judge").usage.input_tokens, 1000);
    assert_eq!(setup.ask(0).unwrap(), Some(SuccessScore::Success));
    assert_eq!((setup.requests(), entries(&setup.path()).len()), (3, 2));
}

#[test]
fn interrupted_panel_resumes() {
    let setup = Setup::new(|n, _| {
        if n == 3 {
            fails(400, "")
        } else {
            says("Final Score: 1")
        }
    });
    let other = EndpointSettings {
        name: "other".to_owned(),
        ..setup.settings.clone()
    };
    let settings = PanelSettings {
        frames: FrameChoice::default(),
        judges: vec![setup.settings.clone(), other],
    };
    let rollouts: Vec<_> = (0..3).map(rollout).collect();
    let run = || {
        let clock: Arc<dyn Clock> = setup.clock.clone();
        let prompts = Arc::new(Prompts::paper().unwrap());
        let mut panel = Panel::with_clock(settings.clone(), prompts, clock).unwrap();
        let mut kept = Vec::new();
        let ratings = panel.success(&rollouts, &mut setup.record(), |done| {
            kept.push((done.judge.to_owned(), done.rollout, done.from_record));
        });
        (ratings, kept)
    };
    let (ratings, kept) = run();
    assert!(matches!(ratings, Err(Error::Rejected { .. })));
    assert_eq!(kept.len(), 3);
    let (ratings, kept) = run();
    let ratings = ratings.unwrap();
    assert_eq!(ratings.judges, ["no_judge", "other"]);
    assert_eq!(ratings.scores, [[Some(1.0); 3]; 2]);
    assert_eq!(ratings.unusable(), [0, 0]);
    assert_eq!(
        kept.iter()
            .filter(|(_, _, from_record)| *from_record)
            .count(),
        3
    );
    // Six questions, one of them sent twice.
    assert_eq!(setup.requests(), 7);
}

/// Set for a child process: a test cannot set its own variables while others run.
const KEY_VARIABLE: &str = "WM_JUDGE_TEST_API_KEY";
const KEY: &str = "sk-not-a-real-key-0123456789";

#[test]
fn api_key_is_sent_and_never_written() {
    if std::env::var_os(KEY_VARIABLE).is_none() {
        let test = std::process::Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "protocol::api_key_is_sent_and_never_written"])
            .env(KEY_VARIABLE, KEY)
            .output()
            .unwrap();
        let printed = String::from_utf8_lossy(&test.stdout).into_owned();
        assert!(
            test.status.success() && printed.contains("1 passed"),
            "{printed}"
        );
        return;
    }
    let mut setup = Setup::new(|n, request| {
        let line = request
            .head
            .lines()
            .find(|line| line.to_lowercase().starts_with("authorization"));
        let quoted = format!("You sent {}", line.unwrap());
        match n {
            0 => says(&format!("{quoted}\nFinal Score: 1")),
            1 => Response::Whole(200, "", quoted),
            _ => Response::Whole(401, "", quoted),
        }
    });
    setup.settings.api_key_env = Some(KEY_VARIABLE.to_owned());
    setup.settings.retries = 0;
    setup.ask(0).unwrap();
    let printed = [
        setup.ask(1).unwrap_err().to_string(),
        format!("{:?}", setup.ask(1).unwrap_err()),
        format!("{:?}", setup.judge()),
        std::fs::read_to_string(setup.path()).unwrap(),
    ];
    for text in printed {
        assert!(text.contains("[API key]") && !text.contains(KEY), "{text}");
    }
    for request in setup.server.requests() {
        assert!(request.head.contains(&format!("Bearer {KEY}\r\n")));
    }
}
