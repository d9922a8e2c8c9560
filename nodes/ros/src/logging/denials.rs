//! Denials of Zenoh's access control as warnings.
//!
//! Zenoh 1.10 logs them at TRACE only, with every permission, and names the certificate only where it decides, not where
//! it uses a decision again. It decides all nine messages of a key at once, when the key is first used; these decisions
//! are no denials yet.

use super::printable::of_others;
use std::{
    cell::Cell,
    collections::HashMap,
    sync::{LazyLock, Mutex, PoisonError},
    time::{Duration, Instant},
};

/// The module of Zenoh that decides.
pub(super) const TARGET: &str = "zenoh::net::routing::interceptor::access_control";

/// The same denial is reported again after this time, with the number of those between.
const PERIOD: Duration = Duration::from_secs(10);

/// The most sessions and denials that are remembered.
const MEMORY: usize = 1024;

/// The decisions on a key, in Zenoh's order. The same word begins the record of a real denial.
const DECISIONS: [&str; 9] = [
    "Query",
    "Reply",
    "Put",
    "Delete",
    "Declare/Undeclare Subscriber",
    "Declare/Undeclare Queryable",
    "Declare/Undeclare Liveliness Token",
    "Liveliness Query",
    "Declare Liveliness Subscriber",
];

/// What the session tried, by Zenoh's words: towards the router, and from it.
const ATTEMPTS: [(&str, &str, &str); 9] = [
    ("Query", "call", "receive calls of"),
    ("Reply", "answer on", "receive answers of"),
    ("Put", "publish", "receive"),
    ("Delete", "delete", "receive deletions of"),
    (
        "Declare Subscriber",
        "subscribe to",
        "learn of subscribers to",
    ),
    ("Declare Queryable", "serve", "learn of servers of"),
    ("Liveliness Token", "announce", "learn of"),
    ("Liveliness Query", "search", "be searched for"),
    ("Declare Liveliness Subscriber", "watch", "be watched for"),
];

static DENIALS: LazyLock<Mutex<Denials>> = LazyLock::new(Mutex::default);

thread_local! {
    /// Progress of the decisions on a new key, as an index into [`DECISIONS`]: Zenoh makes them on one thread, one
    /// after the other.
    static DECIDED: Cell<Option<usize>> = const { Cell::new(None) };
}

/// The warning of a record of [`TARGET`]; `None` if it is none, or was reported just now.
pub(super) fn warning(record: &str) -> Option<String> {
    let mut denials = DENIALS.lock().unwrap_or_else(PoisonError::into_inner);
    denials.warning(record, Instant::now())
}

#[derive(Debug, Default)]
struct Denials {
    /// The common names of certificates, by session.
    names: HashMap<String, String>,
    /// When a denial was reported last, and how often it occurred since.
    reported: HashMap<String, (Instant, u64)>,
}

impl Denials {
    fn warning(&mut self, record: &str, now: Instant) -> Option<String> {
        if record.contains("caching permissions for") {
            DECIDED.set(Some(0));
            return None;
        }
        if let Some((session, _)) = record.split_once(" did not match any configured ACL subject") {
            return Some(format!(
                "access denied: the certificate of session {session} has no rules, so nothing is permitted to it"
            ));
        }
        let (who, what, is_denied) = match record.split_once(" is unauthorized to ") {
            Some((who, what)) => (who, what, true),
            None => match record.split_once(" is authorized to ") {
                Some((who, what)) => (who, what, false),
                None => return None,
            },
        };
        let is_used_again = who.strip_prefix("Using cached result: ");
        let session = match (is_used_again, who.split_once(" on ")) {
            (Some(session), _) => session,
            (None, Some((session, subject))) => {
                self.learn(session, subject);
                if is_decision_on_new_key(what) {
                    return None;
                }
                session
            }
            (None, None) => return None,
        };
        if !is_denied {
            return None;
        }
        let (message, key) = what.rsplit_once(" on ")?;
        let attempt = attempt(message)?;
        let name = match self.names.get(session) {
            Some(name) => name.clone(),
            None => format!("session {session}"),
        };
        let denial = format!("access denied: {name} may not {attempt} {}", of_others(key));
        self.report(denial, now)
    }

    /// `subject` is `[interface+]CertCommonName(name)+link protocol+session`.
    fn learn(&mut self, session: &str, subject: &str) {
        if self.names.contains_key(session) {
            return;
        }
        let Some(rest) = subject.strip_suffix(session) else {
            return;
        };
        let rest = rest.trim_end_matches('+');
        let Some((identity, _protocol)) = rest.rsplit_once('+') else {
            return;
        };
        let name = identity.rsplit('+').next().unwrap_or(identity);
        let inner = name.strip_prefix("CertCommonName(");
        let name = inner
            .and_then(|inner| inner.strip_suffix(')'))
            .unwrap_or(name);
        if self.names.len() >= MEMORY {
            self.names.clear();
        }
        self.names.insert(session.to_owned(), of_others(name));
    }

    fn report(&mut self, denial: String, now: Instant) -> Option<String> {
        if let Some((last, count)) = self.reported.get_mut(&denial) {
            *count += 1;
            if now.saturating_duration_since(*last) < PERIOD {
                return None;
            }
            let text = format!("{denial} ({count} times since the last report)");
            (*last, *count) = (now, 0);
            return Some(text);
        }
        if self.reported.len() >= MEMORY {
            self.reported.clear();
        }
        self.reported.insert(denial.clone(), (now, 0));
        Some(denial)
    }
}

/// Whether the record is one of the decisions that follow the first use of a key. With several subjects, a decision has
/// several records.
fn is_decision_on_new_key(what: &str) -> bool {
    let Some(decided) = DECIDED.get() else {
        return false;
    };
    let of = |decision: &&str| {
        let rest = what.strip_prefix(*decision);
        rest.is_some_and(|rest| rest.starts_with(" ("))
    };
    let index = DECISIONS.iter().position(of);
    let next = index.filter(|index| *index >= decided);
    DECIDED.set(next);
    next.is_some()
}

/// What the session tried, in words; `None` for the end of a declaration, which was denied when it began.
fn attempt(message: &str) -> Option<&'static str> {
    let (message, flow) = message.split_once(" (")?;
    let (_, to_router, from_router) = ATTEMPTS.iter().find(|(word, ..)| *word == message)?;
    Some(match flow.starts_with("ingress") {
        true => to_router,
        false => from_router,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const SUBJECT: &str = "lo+CertCommonName(/wm/view)+tls+ab12";
    const KEY: &str = "0/wm/plan/wm_msgs::msg::dds_::Plan_/RIHS01_00";

    fn warn(denials: &mut Denials, record: &str) -> Option<String> {
        denials.warning(record, Instant::now())
    }

    #[test]
    fn denial_names_certificate_and_key() {
        let mut denials = Denials::default();
        let record = format!("ab12 on {SUBJECT} is unauthorized to Put (ingress) on {KEY}");
        let expected = format!("access denied: /wm/view may not publish {KEY}");
        assert_eq!(warn(&mut denials, &record), Some(expected));
        let permitted = format!("ab12 on {SUBJECT} is authorized to Put (ingress) on 0/rosout/a/b");
        assert_eq!(warn(&mut denials, &permitted), None);
    }

    #[test]
    fn decisions_are_no_denials_but_name_later_ones() {
        let mut denials = Denials::default();
        let caching = format!("ACL (ingress): caching permissions for `{KEY}` ...");
        assert_eq!(warn(&mut denials, &caching), None);
        for decision in DECISIONS {
            let record =
                format!("ab12 on {SUBJECT} is unauthorized to {decision} (ingress) on {KEY}");
            assert_eq!(warn(&mut denials, &record), None, "{decision}");
        }
        let used = format!("Using cached result: ab12 is unauthorized to Put (ingress) on {KEY}");
        let expected = format!("access denied: /wm/view may not publish {KEY}");
        assert_eq!(warn(&mut denials, &used), Some(expected));
        // without the decisions before it, the same record is a denial
        let record = format!("ab12 on {SUBJECT} is unauthorized to Query (ingress) on {KEY}");
        let expected = format!("access denied: /wm/view may not call {KEY}");
        assert_eq!(warn(&mut denials, &record), Some(expected));
    }

    #[test]
    fn repeated_denials_are_counted() {
        let mut denials = Denials::default();
        let record = format!("ab12 on {SUBJECT} is unauthorized to Put (ingress) on {KEY}");
        let start = Instant::now();
        assert!(denials.warning(&record, start).is_some());
        for _ in 0..299 {
            assert_eq!(denials.warning(&record, start + PERIOD / 2), None);
        }
        let later = denials.warning(&record, start + PERIOD).unwrap();
        assert!(
            later.ends_with("(300 times since the last report)"),
            "{later}"
        );
    }

    #[test]
    fn memory_is_bounded_and_control_characters_are_escaped() {
        let mut denials = Denials::default();
        for number in 0..2 * MEMORY {
            let long = "k".repeat(10_000);
            let record = format!(
                "{number:x} on lo+/n{number}+tls+{number:x} is unauthorized to Put (ingress) on {number}/\u{1b}{long}"
            );
            let text = warn(&mut denials, &record).unwrap();
            assert!(text.len() < 1024 && !text.contains('\u{1b}'), "{text}");
        }
        assert!(denials.names.len() <= MEMORY && denials.reported.len() <= MEMORY);
    }

    #[test]
    fn certificate_without_rules_is_reported() {
        let record = "ab12 did not match any configured ACL subject. Default permission `Deny` will be applied on all messages";
        let text = warn(&mut Denials::default(), record).unwrap();
        assert!(text.contains("session ab12 has no rules"), "{text}");
        let other = "Access control is enabled";
        assert_eq!(warn(&mut Denials::default(), other), None);
    }
}
