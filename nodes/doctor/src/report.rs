//! The report: all findings.

use crate::{Finding, Level, Machine, ModelFacts, Survey, action, audit, camera, fit, peers};
use serde::Serialize;
use serde_json::{Value, json};
use std::fmt;

/// In the order of the checks.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Report {
    /// In the order of the checks.
    pub findings: Vec<Finding>,
}

impl Report {
    /// `model`: `None` without a model to check, or the error of opening it. `camera` and `action`: topics that the
    /// user named.
    #[must_use]
    pub fn of(
        machine: &Machine,
        survey: &Survey,
        model: Option<Result<&ModelFacts, String>>,
        (camera, action): (Option<&str>, Option<&str>),
    ) -> Self {
        let facts = model
            .as_ref()
            .and_then(|model| model.as_ref().ok().copied());
        let mut findings = machine.check(survey);
        findings.extend(camera::check(survey, camera));
        findings.extend(action::check(survey, camera, action, facts));
        findings.extend(audit::check(survey, (camera, action), facts));
        match &model {
            None => {}
            Some(Ok(facts)) => findings.extend(fit::check(facts, survey.camera(camera))),
            Some(Err(problem)) => findings.push(
                Finding::error("model", problem.clone())
                    .because("no node that computes starts with this model")
                    .fix("run wm model check DIR for details; --model tiny is the bundled model"),
            ),
        }
        findings.extend(peers::check(survey));
        Self { findings }
    }

    /// The worst level of the findings.
    #[must_use]
    pub fn worst(&self) -> Level {
        let levels = self.findings.iter().map(|finding| finding.level);
        levels.max().unwrap_or(Level::Ok)
    }

    /// For programs: `worst`, `findings`, and statistics of the topics.
    #[must_use]
    pub fn json(&self, survey: &Survey) -> Value {
        let stream = |stream: &crate::Stream| {
            json!({
                "topic": stream.topic,
                "type": stream.type_name,
                "publishers": stream.publishers.iter().map(ToString::to_string).collect::<Vec<_>>(),
                "messages": stream.timeline.len(),
                "rate_hz": stream.timeline.period_s().map(|period_s| 1.0 / period_s),
                "picture_rate_hz": stream.timeline.picture_period_s().map(|period_s| 1.0 / period_s),
                "delay_s": stream.timeline.delay_s(),
                "lost": stream.lost,
                "undecodable": stream.undecodable,
                "frame_ids": stream.frame_ids,
                "largest_bytes": stream.largest,
            })
        };
        let camera = |(name, camera): (&String, &crate::Camera)| {
            let picture = camera.pictures.iter().flatten().next();
            json!({
                "camera": name,
                "encoding": camera.encoding,
                "size": picture.map(|picture| [picture.size.0, picture.size.1]),
                "mean": picture.map(|picture| picture.mean),
                "spread": picture.map(|picture| picture.spread),
                "topics": camera.streams().map(stream).collect::<Vec<_>>(),
            })
        };
        json!({
            "worst": self.worst(),
            "findings": self.findings,
            "listened_s": survey.span.as_secs_f64(),
            "participants": survey.participants,
            "cameras": survey.cameras.iter().map(camera).collect::<Vec<_>>(),
            "actions": survey.actions.values().map(|actions| stream(&actions.stream)).collect::<Vec<_>>(),
            "motions": survey.motions,
        })
    }

    fn count(&self, level: Level) -> usize {
        let same = |finding: &&Finding| finding.level == level;
        self.findings.iter().filter(same).count()
    }
}

/// A line for each finding, with reason and fix below it, and a summary.
impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for finding in &self.findings {
            writeln!(f, "{finding}")?;
        }
        let count = |level, one: &str, many: &str| match self.count(level) {
            1 => format!("1 {one}"),
            count => format!("{count} {many}"),
        };
        writeln!(
            f,
            "{}, {}",
            count(Level::Error, "error", "errors"),
            count(Level::Warning, "warning", "warnings")
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report() -> Report {
        let findings = vec![
            Finding::ok("memory", "4.0 GiB free"),
            Finding::error("camera", "no image topic")
                .because("nothing is predicted")
                .fix("start the driver"),
        ];
        Report { findings }
    }

    #[test]
    fn text_contains_finding_reason_and_fix() {
        assert_eq!(
            report().to_string(),
            [
                "ok       memory     4.0 GiB free\n",
                "ERROR    camera     no image topic\n",
                "                    why:  nothing is predicted\n",
                "                    fix:  start the driver\n",
                "1 error, 0 warnings\n",
            ]
            .concat()
        );
        assert_eq!(Report::default().worst(), Level::Ok);
    }

    #[test]
    fn json_omits_missing_fields() {
        let json = report().json(&Survey::default());
        assert_eq!(json["worst"], "error");
        assert_eq!(
            json["findings"][0],
            json!({"check": "memory", "level": "ok", "what": "4.0 GiB free"})
        );
        assert_eq!(json["findings"][1]["fix"], "start the driver");
    }
}
