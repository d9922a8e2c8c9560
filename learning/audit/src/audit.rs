//! The combined findings of an audit.

use crate::{Episodes, Finding, Level, behaviour, effect, lag};
use serde::{Deserialize, Serialize};
use std::{collections::BTreeMap, fmt};

/// Limit of bag names in a finding.
const BAG_NAMES_LIMIT: usize = 50;

/// The findings about a recording or a data set.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Audit {
    /// Faults first.
    pub findings: Vec<Finding>,
}

/// The findings about one bag of a data set.
#[derive(Clone, Debug, Default)]
pub struct BagFindings {
    /// Name of the bag.
    pub bag: String,
    /// The findings.
    pub findings: Vec<Finding>,
    /// Picture sizes of the first camera, width and height \[px\].
    pub sizes: Vec<(u32, u32)>,
}

impl Audit {
    /// The findings about all episodes together.
    #[must_use]
    pub fn of_episodes(episodes: Episodes<'_>) -> Vec<Finding> {
        let mut findings = lag::check(episodes);
        findings.extend(effect::check(episodes));
        findings.extend(behaviour::check(episodes));
        findings
    }

    /// Combines the findings about each bag with those about all.
    #[must_use]
    pub fn new(bags: &[BagFindings], all: Vec<Finding>) -> Self {
        let mut findings = join(bags);
        findings.extend(compare_sizes(bags));
        findings.extend(all);
        // The sort is stable: within a level, the order of the checks stays.
        findings.sort_by_key(|finding| std::cmp::Reverse(finding.level));
        Self { findings }
    }

    /// The worst level; [`Level::Ok`] without findings.
    #[must_use]
    pub fn worst(&self) -> Level {
        let levels = self.findings.iter().map(|finding| finding.level);
        levels.max().unwrap_or_default()
    }

    /// The findings that need action.
    pub fn faults(&self) -> impl Iterator<Item = &Finding> {
        self.findings.iter().filter(|finding| finding.is_fault())
    }
}

/// One line per finding, and a summary.
impl fmt::Display for Audit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for finding in &self.findings {
            writeln!(f, "{finding}")?;
        }
        let count = |level| {
            self.findings
                .iter()
                .filter(|finding| finding.level == level)
                .count()
        };
        let counted = |count: usize, thing: &str| match count {
            1 => format!("1 {thing}"),
            count => format!("{count} {thing}s"),
        };
        write!(
            f,
            "audit: {}, {}, {}",
            counted(count(Level::Error), "error"),
            counted(count(Level::Warning), "warning"),
            counted(count(Level::Note), "note")
        )
    }
}

/// Findings with the names of their bags.
type NamedFindings<'a> = Vec<(&'a str, &'a Finding)>;

/// Merges findings that several bags share.
fn join(bags: &[BagFindings]) -> Vec<Finding> {
    let mut groups: BTreeMap<(String, Level, String), NamedFindings<'_>> = BTreeMap::new();
    for bag in bags {
        for finding in &bag.findings {
            let key = (
                finding.check.to_string(),
                finding.level,
                remove_numbers(&finding.what),
            );
            groups.entry(key).or_default().push((&bag.bag, finding));
        }
    }
    let join = |group: NamedFindings<'_>| {
        let (name, first) = group.first()?;
        let mut finding = (*first).clone();
        let mut names: Vec<String> = group.iter().map(|(name, _)| (*name).to_owned()).collect();
        names.dedup();
        if bags.len() > 1 {
            finding.what = match (names.len(), finding.level) {
                (1, _) => format!("{name}: {}", finding.what),
                (count, Level::Ok) => format!("{count} bags like {name}: {}", finding.what),
                (count, _) => format!(
                    "{count} of {} bags, first {name}: {}",
                    bags.len(),
                    finding.what
                ),
            };
            finding = finding.figure("bags", names.len() as f64);
        }
        names.truncate(BAG_NAMES_LIMIT);
        finding.bags = names;
        Some(finding)
    };
    groups.into_values().filter_map(join).collect()
}

/// The verdict without its numbers, which is equal for bags with the same fault.
fn remove_numbers(what: &str) -> String {
    what.chars()
        .filter(|letter| !letter.is_ascii_digit() && *letter != '.')
        .collect()
}

/// Checks that all bags have the same picture size.
fn compare_sizes(bags: &[BagFindings]) -> Option<Finding> {
    let mut sizes: BTreeMap<(u32, u32), Vec<&str>> = BTreeMap::new();
    for bag in bags {
        if let [only] = bag.sizes.as_slice() {
            sizes.entry(*only).or_default().push(&bag.bag);
        }
    }
    if sizes.len() < 2 {
        return None;
    }
    let shown = sizes.iter().take(4).map(|((width, height), bags)| {
        // Each size has at least one bag.
        let first = bags.first().copied().unwrap_or_default();
        format!("{width}x{height} in {} (first {first})", bags.len())
    });
    let what = format!(
        "the bags have pictures of {} sizes: {}",
        sizes.len(),
        shown.collect::<Vec<_>>().join(", ")
    );
    let mut shapes = sizes
        .keys()
        .map(|(width, height)| f64::from(*width) / f64::from((*height).max(1)));
    // There are at least two sizes.
    let first = shapes.next().unwrap_or(1.0);
    let finding = if shapes.all(|shape| (shape / first - 1.0).abs() < 0.01) {
        Finding::note("sizes", what)
    } else {
        Finding::warning("sizes", what)
            .because("pictures of different shapes are fitted to the model's differently, so the same object looks different")
            .fix("prepare bags of one shape, or crop the others first")
    };
    Some(finding.figure("sizes", sizes.len() as f64))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn bag(name: &str, finding: Finding, size: (u32, u32)) -> BagFindings {
        BagFindings {
            bag: name.into(),
            findings: vec![finding],
            sizes: vec![size],
        }
    }

    #[test]
    fn bags_with_the_same_fault_share_a_finding() {
        let repeats =
            |share: u32| Finding::warning("repeats", format!("/camera: {share} % repeat"));
        let bags = [
            bag("a", repeats(40), (64, 48)),
            bag("b", repeats(50), (64, 48)),
            bag("c", Finding::error("frozen", "frozen"), (64, 48)),
        ];
        let audit = Audit::new(&bags, vec![Finding::ok("lag", "0 frames")]);
        let what: Vec<&str> = audit.findings.iter().map(|f| f.what.as_str()).collect();
        assert_eq!(
            what,
            [
                "c: frozen",
                "2 of 3 bags, first a: /camera: 40 % repeat",
                "0 frames"
            ]
        );
        assert_eq!(audit.findings[1].bags, ["a", "b"]);
        assert_eq!((audit.worst(), audit.faults().count()), (Level::Error, 2));
        assert!(
            audit
                .to_string()
                .ends_with("audit: 1 error, 1 warning, 0 notes")
        );
    }

    #[test]
    fn different_shapes_are_a_fault_different_sizes_a_note() {
        let of = |name, size| bag(name, Finding::ok("frames", "good"), size);
        let same = Audit::new(&[of("a", (64, 48)), of("b", (640, 480))], Vec::new());
        assert_eq!(same.worst(), Level::Note);
        let other = Audit::new(&[of("a", (64, 48)), of("b", (128, 72))], Vec::new());
        assert_eq!(other.worst(), Level::Warning);
        assert!(other.findings[0].what.contains("128x72 in 1 (first b)"));
    }

    #[test]
    fn single_bag_is_not_named() {
        let audit = Audit::new(
            &[bag("a", Finding::warning("frozen", "frozen"), (1, 1))],
            Vec::new(),
        );
        assert_eq!(audit.findings[0].what, "frozen");
        let json = serde_json::to_string(&audit).unwrap();
        assert_eq!(serde_json::from_str::<Audit>(&json).unwrap(), audit);
    }
}
