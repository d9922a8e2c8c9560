//! Ranks of models by their judges.

use wm_metrics::findings::{ModelFindings, Suite, TextTable};
use wm_metrics::ranking::{Ties, borda, ranks};

/// Prefix of success rates by judge.
const BY_JUDGE: &str = "policy.success_by_";

/// Borda ranks: the sum over judges of a model's rank by success rate; equal models share the better rank; the lowest
/// sum is best. Only judges of all models count; `None` for fewer than two models.
#[must_use]
pub fn borda_of(findings: &[ModelFindings]) -> Option<TextTable> {
    let (first, others) = findings.split_first()?;
    if others.is_empty() {
        return None;
    }
    let rates = |name: &str| -> Option<Vec<f64>> {
        let rates = findings
            .iter()
            .map(|model| model.metrics().get(name).map(|m| m.value));
        rates.collect()
    };
    let judges = first.metrics();
    let judges = judges.keys().filter_map(|name| {
        let judge = name.strip_prefix(BY_JUDGE)?;
        Some((judge.to_owned(), rates(name)?))
    });
    let (judges, rates): (Vec<String>, Vec<Vec<f64>>) = judges.unzip();
    let sums = borda(&rates, Ties::Best).ok()?;
    let ranks: Vec<Vec<f64>> = rates
        .iter()
        .map(|rates| ranks(rates, Ties::Best))
        .collect::<Result<_, _>>()
        .ok()?;
    let rows = findings
        .iter()
        .zip(sums)
        .enumerate()
        .map(|(index, (model, sum))| {
            let own = ranks.iter().zip(&rates).map(|(ranks, rates)| {
                // In range: ranks and rates have one value per model.
                let at = |values: &[f64]| values.get(index).copied().unwrap_or(f64::NAN);
                format!("{} ({:.3})", at(ranks), at(rates))
            });
            let mut row = vec![model.header.model.clone()];
            row.extend(own);
            row.push(sum.to_string());
            row
        });
    let by = judges
        .iter()
        .map(|judge| format!("rank by {judge} (success rate)"));
    let mut header = vec!["model".to_owned()];
    header.extend(by);
    header.push("Borda rank, lower is better".into());
    Some(TextTable {
        title: "Models ranked by their judges".into(),
        header,
        rows: rows.collect(),
    })
}

/// Adds the ranks to the findings of several models.
pub(crate) fn with_borda(mut findings: Vec<ModelFindings>) -> Vec<ModelFindings> {
    if let Some(table) = borda_of(&findings) {
        for model in &mut findings {
            let sections = model.sections.iter_mut();
            for section in sections.filter(|section| section.suite == Suite::Policy) {
                section.tables.push(table.clone());
            }
        }
    }
    findings
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use wm_metrics::findings::{Better, Header, Metric, Section};

    use super::*;

    fn model(name: &str, rates: &[(&str, f64)]) -> ModelFindings {
        let mut section = Section::new(Suite::Policy);
        for (judge, rate) in rates {
            let name = format!("success_by_{judge}");
            section.metric(&name, Metric::plain(*rate, 8, Better::Higher, "a rate"));
        }
        ModelFindings {
            header: Header::of(name, name, ""),
            sections: vec![section],
        }
    }

    #[test]
    fn ranks_are_summed_over_common_judges() {
        let models = [
            model("a", &[("x", 0.5), ("y", 0.1), ("z", 0.9)]),
            model("b", &[("x", 0.5), ("y", 0.4)]),
            model("c", &[("x", 0.2), ("y", 0.3)]),
        ];
        let table = borda_of(&models).unwrap();
        assert_eq!(table.header.len(), 4);
        let sums: Vec<&str> = table.rows.iter().map(|row| &*row[3]).collect();
        assert_eq!(sums, ["4", "2", "5"]);
        assert_eq!(table.rows[0][1], "1 (0.500)");
        assert_eq!(with_borda(models.to_vec())[2].sections[0].tables, [table]);
    }

    #[test]
    fn ranks_need_two_models_and_a_judge() {
        let judged = model("a", &[("x", 0.5)]);
        assert_eq!(borda_of(std::slice::from_ref(&judged)), None);
        assert_eq!(borda_of(&[judged, model("b", &[])]), None);
        assert_eq!(borda_of(&[]), None);
    }
}
