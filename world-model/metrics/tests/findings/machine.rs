use proptest::prelude::*;
use serde_json::{Value, json};
use wm_metrics::findings::{Better, Metric, ModelFindings, Section, Suite};
use wm_metrics::statistics::Interval;

use super::{reading, sample::findings};

fn parsed(findings: &[ModelFindings]) -> Value {
    serde_json::from_str(&wm_metrics::findings::json(findings).unwrap()).unwrap()
}

#[test]
fn one_model() {
    let one = findings("sample-a", 0);
    let value = parsed(std::slice::from_ref(&one));
    assert_eq!(value["model"], "sample-a");
    assert_eq!(value["seed"], 7);
    assert_eq!(value["settings"]["cem"]["elites"], 8);
    let metrics = value["metrics"].as_object().unwrap();
    assert_eq!(metrics.len(), one.metrics().len());
    let psnr = &metrics["fidelity.psnr"];
    let found = one.metrics()["fidelity.psnr"];
    let high = found.interval.unwrap().high;
    assert!((psnr["value"].as_f64().unwrap() - found.value).abs() < 1e-9);
    assert!((psnr["interval"][1].as_f64().unwrap() - high).abs() < 1e-9);
    assert_eq!(
        (&psnr["unit"], &psnr["better"]),
        (&json!("dB"), &json!("higher"))
    );
    assert_eq!(psnr["n"], 20);
    assert!(psnr.get("samples").is_none());
    assert!(metrics["fidelity.fvd"]["interval"].is_null());
    assert!(!metrics.contains_key("fidelity.not_a_number"));
    let why = value["absent"]["fidelity.not_a_number"].as_str().unwrap();
    assert!(why.contains("not finite"));
}

#[test]
fn several_models_and_none() {
    let three = ["a", "b", "c"].map(|name| findings(name, name.len() as u64));
    let value = parsed(&three);
    assert_eq!(value["models"].as_array().unwrap().len(), 3);
    let comparisons = value["comparisons"].as_array().unwrap();
    assert_eq!(comparisons.len(), 2);
    assert_eq!(comparisons[1]["baseline"]["model"], "a");
    assert_eq!(comparisons[1]["model"]["model"], "c");
    let psnr = &comparisons[1]["metrics"]["fidelity.psnr"];
    assert_eq!(
        (psnr["difference"].as_f64(), psnr["n"].as_u64()),
        (Some(0.0), Some(20))
    );
    assert_eq!(parsed(&[]), json!({"models": [], "comparisons": []}));
}

#[test]
fn equal_findings_give_equal_bytes() {
    let with = |zero: f64, settings: &str| {
        let mut one = findings("a", 0);
        one.header.settings = serde_json::from_str(settings).unwrap();
        one.sections[0].metric("zero", Metric::plain(zero, 1, Better::Lower, ""));
        wm_metrics::findings::json(&[one]).unwrap()
    };
    let text = with(0.0, r#"{"a": {"x": 1, "y": [2]}, "b": null}"#);
    assert_eq!(text, with(-0.0, r#"{"b": null, "a": {"y": [2], "x": 1}}"#));
    let order = [
        "\"model\"",
        "\"hash\"",
        "\"settings\"",
        "\"metrics\"",
        "\"absent\"",
    ];
    let places = order.map(|key| text.find(key).unwrap());
    assert!(places.is_sorted());
}

proptest! {
    #[test]
    fn any_findings_can_be_read_back(
        model: String, unit: String, name: String, hash: String,
        value: f64, low: f64, high: f64, n: usize,
    ) {
        let mut one = findings(&model, 0);
        one.header.hash = hash;
        let mut section = Section::new(Suite::Cost);
        let interval = Some(Interval { low, high });
        section.metric(&name, Metric { interval, ..Metric::plain(value, n, Better::Lower, "").in_unit(&unit) });
        one.sections = vec![section];
        let name = format!("cost.{name}");

        let text = wm_metrics::findings::json(&[one.clone()]).unwrap();
        let told: Value = serde_json::from_str(&text).unwrap();
        let records = reading::csv(&wm_metrics::findings::csv(&[one.clone()]));
        prop_assert_eq!(records[0].join(","), "model,hash,metric,value,low,high,n,unit,better");
        if !value.is_finite() {
            prop_assert_eq!(records.len(), 1);
            prop_assert!(told["absent"][&name].is_string());
            return Ok(());
        }
        let found = &told["metrics"][&name];
        // `serde_json` parses floats up to the last digit; the text is exact.
        let metrics = &text[text.find("\n  \"metrics\"").unwrap()..];
        let written = metrics.split("\n      \"value\": ").nth(1).unwrap();
        let written = written.split(',').next().unwrap();
        prop_assert_eq!(written.parse::<f64>().unwrap(), value);
        let ends = low.is_finite() && high.is_finite();
        prop_assert_eq!(found["interval"].is_array(), ends);
        let end = |text: &String| (!text.is_empty()).then(|| text.parse::<f64>().unwrap());
        let row = &records[1];
        prop_assert_eq!((&row[0], &row[1], &row[2]), (&model, &one.header.hash, &name));
        prop_assert_eq!(row[3].parse::<f64>().unwrap(), value);
        prop_assert_eq!((end(&row[4]), end(&row[5])), (ends.then_some(low), ends.then_some(high)));
        prop_assert_eq!((&row[6], &row[7], row[8].as_str()), (&n.to_string(), &unit, "lower"));
    }
}
