//! All findings together.

use crate::{Finding, Heard, Level, Machine, ModelFacts, action, audit, camera, fit, peers};
use serde::Serialize;
use serde_json::{Value, json};
use std::fmt;

/// All findings together, in the order of the checks.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Report {
    /// What was found.
    pub findings: Vec<Finding>,
}

impl Report {
    /// What is to be said of all that is known. `model` is none where none was to be tried, or what is wrong with it;
    /// `camera` and `action` are the topics that the user named.
    #[must_use]
    pub fn of(
        machine: &Machine,
        heard: &Heard,
        model: Option<Result<&ModelFacts, String>>,
        (camera, action): (Option<&str>, Option<&str>),
    ) -> Self {
        let facts = model
            .as_ref()
            .and_then(|model| model.as_ref().ok().copied());
        let mut findings = machine.check(heard);
        findings.extend(camera::check(heard, camera));
        findings.extend(action::check(heard, camera, action, facts));
        findings.extend(audit::check(heard, (camera, action), facts));
        match &model {
            None => {}
            Some(Ok(facts)) => findings.extend(fit::check(facts, heard.camera(camera))),
            Some(Err(problem)) => findings.push(
                Finding::error("model", problem.clone())
                    .because("no node that computes starts with this model")
                    .fix("wm model check DIR says more; --model tiny is the bundled one"),
            ),
        }
        findings.extend(peers::check(heard));
        Self { findings }
    }

    /// The worst of them.
    #[must_use]
    pub fn worst(&self) -> Level {
        let levels = self.findings.iter().map(|finding| finding.level);
        levels.max().unwrap_or(Level::Ok)
    }

    /// As a program reads it: `worst`, `findings`, and what was heard in figures.
    #[must_use]
    pub fn json(&self, heard: &Heard) -> Value {
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
                "bad_times": stream.bad_times,
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
            "listened_s": heard.span.as_secs_f64(),
            "participants": heard.participants,
            "cameras": heard.cameras.iter().map(camera).collect::<Vec<_>>(),
            "actions": heard.actions.values().map(|actions| stream(&actions.stream)).collect::<Vec<_>>(),
            "motions": heard.motions,
        })
    }

    fn count(&self, level: Level) -> usize {
        let same = |finding: &&Finding| finding.level == level;
        self.findings.iter().filter(same).count()
    }
}

/// A line for each finding, with why and fix below it, and one for all of them.
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
    fn text_has_what_why_and_mend() {
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
    fn json_has_the_same_and_leaves_out_what_is_not_there() {
        let json = report().json(&Heard::default());
        assert_eq!(json["worst"], "error");
        assert_eq!(
            json["findings"][0],
            json!({"check": "memory", "level": "ok", "what": "4.0 GiB free"})
        );
        assert_eq!(json["findings"][1]["fix"], "start the driver");
    }
}
