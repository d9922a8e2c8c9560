//! QoS as the last chunk of a liveliness token:
//! `reliability:durability:history,depth:deadline:lifespan:liveliness`, where a field with the default value is empty.
//! Deadlines, lifespans and leases are not used here and have their default, which is infinite.

use crate::{Durability, Qos, Reliability};

/// The depth that is omitted (`QoS::default_qos` of rmw_zenoh).
const DEFAULT_DEPTH: usize = 42;
/// Fields of the text.
const FIELDS: usize = 6;

/// The text of a profile.
pub(super) fn text(qos: Qos) -> String {
    let reliability = match qos.reliability {
        Reliability::Reliable => "",
        Reliability::BestEffort => "2",
    };
    let durability = match qos.durability {
        Durability::Volatile => "",
        Durability::TransientLocal => "1",
    };
    let depth = match qos.depth.max(1) {
        DEFAULT_DEPTH => String::new(),
        depth => depth.to_string(),
    };
    format!("{reliability}:{durability}:,{depth}:,:,:,,")
}

/// The profile of a text; `None` if it is malformed. History "keep all" reads as the largest depth. Unknown values read
/// as the default.
pub(super) fn parse(text: &str) -> Option<Qos> {
    let fields: Vec<&str> = text.split(':').collect();
    let [reliability, durability, history, ..] = fields[..] else {
        return None;
    };
    let (history, depth) = history.split_once(',')?;
    let is_whole = fields.len() >= FIELDS;
    let depth = match (history, depth) {
        ("2", _) => usize::MAX,
        (_, "" | "0") => DEFAULT_DEPTH,
        (_, depth) => depth.parse().ok()?,
    };
    is_whole.then_some(Qos {
        reliability: match reliability {
            "2" => Reliability::BestEffort,
            _ => Reliability::Reliable,
        },
        durability: match durability {
            "1" => Durability::TransientLocal,
            _ => Durability::Volatile,
        },
        depth,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn texts_are_those_of_rmw_zenoh() {
        for (qos, expected) in [
            (Qos::reliable(10), "::,10:,:,:,,"),
            (Qos::reliable(42), "::,:,:,:,,"),
            (Qos::best_effort(5), "2::,5:,:,:,,"),
            (Qos::latched(1), ":1:,1:,:,:,,"),
        ] {
            assert_eq!(text(qos), expected);
        }
    }

    #[test]
    fn foreign_texts_are_understood() {
        assert_eq!(parse("::2,:,:,:,,").map(|qos| qos.depth), Some(usize::MAX));
        assert_eq!(parse("1:2:1,7:1,500:,:3,1,2"), Some(Qos::reliable(7)));
        assert_eq!(parse("3:3:,:,:,:,,"), Some(Qos::reliable(42)));
        for malformed in ["", "::", "::,10", "::10:,:,:,,", "::,x:,:,:,,"] {
            assert_eq!(parse(malformed), None, "{malformed}");
        }
    }

    proptest! {
        #[test]
        fn profiles_survive(is_reliable: bool, is_latched: bool, depth in 1_usize..10_000) {
            let qos = Qos {
                reliability: if is_reliable { Reliability::Reliable } else { Reliability::BestEffort },
                durability: if is_latched { Durability::TransientLocal } else { Durability::Volatile },
                depth,
            };
            prop_assert_eq!(parse(&text(qos)), Some(qos));
        }

        #[test]
        fn arbitrary_texts_do_not_panic(text in ".{0,60}") {
            parse(&text);
        }
    }
}
