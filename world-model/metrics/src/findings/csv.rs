//! Findings as comma-separated values (RFC 4180).

use crate::findings::{ModelFindings, number::exact};

/// One row per model and figure, with columns `model,hash,metric,value,low,high,n,unit,better`; `low` and `high` are
/// empty without an interval. Figures that are not finite are skipped; [`json`](crate::findings::json()) has the reason.
#[must_use]
pub fn csv(findings: &[ModelFindings]) -> String {
    let mut text = String::from("model,hash,metric,value,low,high,n,unit,better\r\n");
    for one in findings {
        for (name, metric) in one.metrics() {
            let interval = metric.finite_interval();
            let end = |end: Option<f64>| end.map(exact).unwrap_or_default();
            let fields = [
                field(&one.header.model),
                field(&one.header.hash),
                field(name),
                exact(metric.value),
                end(interval.map(|interval| interval.low)),
                end(interval.map(|interval| interval.high)),
                metric.n.to_string(),
                field(&metric.unit),
                metric.better.name().to_owned(),
            ];
            text.push_str(&fields.join(","));
            text.push_str("\r\n");
        }
    }
    text
}

/// Quotes a field if necessary.
fn field(text: &str) -> String {
    if text.contains([',', '"', '\r', '\n']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}
