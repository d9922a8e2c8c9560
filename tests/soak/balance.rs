//! Checks that every sent message was received or counted as lost.

use std::{collections::BTreeMap, time::Duration};

use serde_json::{Value, json};

use crate::fault::Kind;

/// Counters of each node, by name.
pub type Totals = BTreeMap<String, BTreeMap<String, u64>>;

/// Publisher, topic and subscriber. The nodes are in the namespace `/wm`.
const LINKS: [(&str, &str, &str); 7] = [
    ("soak", "/camera/image_raw", "encoder"),
    ("encoder", "/wm/latent", "planner"),
    ("planner", "/wm/plan", "executor"),
    ("executor", "/wm/command/twist", "sim_arm"),
    ("executor", "/wm/action_chunk", "planner"),
    ("soak", "/wm/ee_pose", "executor"),
    ("soak", "/wm/action", "planner"),
];
/// Nodes report their counters once per second, at different times, and messages are on their way.
const SLACK: Duration = Duration::from_secs(4);

/// One publisher and one of its subscribers.
#[derive(Debug)]
struct Link {
    from: &'static str,
    topic: &'static str,
    to: &'static str,
    /// The time and the counters when both had lived for a whole round.
    base: Option<(Duration, Counts)>,
    judged: u64,
    sent: u64,
    /// The result of the last comparison in the current span.
    sent_in_span: u64,
    /// The most messages that were neither received nor counted, and the spans in which they were too many.
    worst: i64,
    failures: Vec<String>,
}

#[derive(Clone, Copy, Debug)]
struct Counts {
    sent: u64,
    received: u64,
    lost: u64,
}

impl Link {
    fn counts(&self, totals: &Totals) -> Counts {
        let of = |node: &str, matches: &dyn Fn(&str) -> bool| -> u64 {
            let counters = totals.get(&format!("wm/{node}")).into_iter().flatten();
            let counters = counters.filter(|(key, _)| matches(key));
            counters.map(|(_, count)| count).sum()
        };
        // messages that a node receives and drops later count as received
        let lost = format!("dropped: {}: lost in transport", self.topic);
        Counts {
            sent: of(self.from, &|key| key == format!("sent {}", self.topic)),
            received: of(self.to, &|key| key == format!("received {}", self.topic)),
            lost: of(self.to, &|key| key == lost),
        }
    }

    fn name(&self) -> String {
        format!("{} {} {}", self.from, self.topic, self.to)
    }

    /// Compares after another round of both nodes.
    fn judge(&mut self, at: Duration, totals: &Totals) {
        let now = self.counts(totals);
        let Some((since, base)) = self.base else {
            self.base = Some((at, now));
            return;
        };
        let sent = now.sent - base.sent;
        let accounted = now.received - base.received + (now.lost - base.lost);
        let missing = sent as i64 - accounted as i64;
        let seconds = (at - since).as_secs_f64().max(1.0);
        let slack = 2.0 + sent as f64 / seconds * SLACK.as_secs_f64();
        self.judged += 1;
        self.sent += sent - self.sent_in_span;
        self.sent_in_span = sent;
        if missing.abs() > self.worst.abs() {
            self.worst = missing;
        }
        if missing.abs() as f64 > slack {
            self.failures.push(format!(
                "{:.0} s to {:.0} s: {sent} sent, {accounted} received or counted as lost",
                since.as_secs_f64(),
                at.as_secs_f64()
            ));
            self.base = Some((at, now));
            self.sent_in_span = 0;
        }
    }
}

#[derive(Debug)]
pub struct Balance(Vec<Link>);

impl Balance {
    pub fn new() -> Self {
        let link = |(from, topic, to)| Link {
            from,
            topic,
            to,
            base: None,
            judged: 0,
            sent: 0,
            sent_in_span: 0,
            worst: 0,
            failures: Vec::new(),
        };
        Self(LINKS.map(link).into())
    }

    /// Takes a round, in which the processes `deaths` ended.
    pub fn add(&mut self, at: Duration, kind: Kind, deaths: &[&str], totals: &Totals) {
        // their messages arrive after the round
        let is_under_way = matches!(kind, Kind::Cut | Kind::StopPlanner | Kind::StopExecutor);
        for link in &mut self.0 {
            if deaths.contains(&link.from) || deaths.contains(&link.to) {
                link.base = None;
                link.sent_in_span = 0;
            } else if !is_under_way {
                link.judge(at, totals);
            }
        }
    }

    /// Whether every loss was counted.
    pub fn is_kept(&self) -> bool {
        self.0.iter().all(|link| link.failures.is_empty())
    }

    pub fn json(&self) -> Value {
        let links = self.0.iter().map(|link| {
            let figures = json!({
                "judged_rounds": link.judged,
                "sent": link.sent,
                "most_missing": link.worst,
                "failures": link.failures,
            });
            (link.name(), figures)
        });
        links.collect()
    }

    pub fn markdown(&self) -> String {
        let mut text = String::from(
            "| publisher, topic, subscriber | rounds judged | sent | most missing | unbalanced |\n|---|---|---|---|---|\n",
        );
        for link in &self.0 {
            text += &format!(
                "| {} | {} | {} | {} | {} |\n",
                link.name(),
                link.judged,
                link.sent,
                link.worst,
                link.failures.len()
            );
        }
        text
    }
}
