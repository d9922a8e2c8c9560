//! `--families`: families of models against each other.

use std::str::FromStr;

use anyhow::{Context as _, Result, ensure};
use wm_metrics::findings::{ModelFindings, family};

/// A family as an option: `NAME=MODEL,MODEL`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FamilyArg {
    name: String,
    models: Vec<String>,
}

impl FromStr for FamilyArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || format!("`{text}`, expected NAME=MODEL,MODEL");
        let (name, models) = text.split_once('=').ok_or_else(expected)?;
        let models: Vec<String> = models.split(',').map(str::to_owned).collect();
        if name.is_empty() || models.iter().any(String::is_empty) {
            return Err(expected());
        }
        Ok(Self {
            name: name.to_owned(),
            models,
        })
    }
}

/// The mean of each family.
///
/// # Errors
/// If a family names a model that was not measured, a model is in two families, or they cannot be compared.
pub(crate) fn means(
    families: &[FamilyArg],
    findings: &[ModelFindings],
) -> Result<Vec<ModelFindings>> {
    ensure!(
        families.len() != 1,
        "--families has one family: nothing to compare it with"
    );
    let mut seen = Vec::new();
    let means = families.iter().map(|own| {
        let members = own.models.iter().map(|model| {
            let found = member(findings, model)?;
            ensure!(
                !seen.contains(&&found.header.hash),
                "--families has {model} twice"
            );
            seen.push(&found.header.hash);
            Ok(found)
        });
        let members = members.collect::<Result<Vec<_>>>()?;
        Ok(family(&own.name, &members)?)
    });
    means.collect()
}

/// The findings of a model by its name or its folder's.
fn member<'a>(findings: &'a [ModelFindings], model: &str) -> Result<&'a ModelFindings> {
    let folder = model.trim_end_matches('/');
    let named = findings.iter().find(|found| {
        let own = found.header.model.trim_end_matches('/');
        own == folder || own.rsplit('/').next() == folder.rsplit('/').next()
    });
    named.with_context(|| {
        let known = findings.iter().map(|found| &*found.header.model);
        let known = known.collect::<Vec<_>>().join(", ");
        format!("--families: no model `{model}` among {known}")
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_metrics::findings::Header;

    fn findings(name: &str) -> ModelFindings {
        ModelFindings {
            header: Header::of(name, &format!("hash of {name}"), "space"),
            sections: Vec::new(),
        }
    }

    fn families(texts: &[&str]) -> Vec<FamilyArg> {
        texts.iter().map(|text| text.parse().unwrap()).collect()
    }

    #[test]
    fn families_have_their_models() {
        let all = [findings("a"), findings("runs/b"), findings("c")];
        let found = means(&families(&["first=a,b", "second=c/"]), &all).unwrap();
        let names: Vec<&str> = found.iter().map(|own| &*own.header.model).collect();
        assert_eq!(names, ["first", "second"]);
        assert_eq!(found[0].header.hash, "hash of a+hash of runs/b");
        assert!(means(&[], &all).unwrap().is_empty());
    }

    #[test]
    fn wrong_families_are_named() {
        let all = [findings("a"), findings("b")];
        for (texts, expected) in [
            (
                &["first=a", "second=x"] as &[&str],
                "no model `x` among a, b",
            ),
            (&["first=a", "second=a"], "a twice"),
            (&["first=a,b"], "one family"),
        ] {
            let error = format!("{:#}", means(&families(texts), &all).unwrap_err());
            assert!(error.contains(expected), "{error}");
        }
        for text in ["a", "=a", "first=", "first=a,,b"] {
            assert!(text.parse::<FamilyArg>().is_err(), "{text}");
        }
    }
}
