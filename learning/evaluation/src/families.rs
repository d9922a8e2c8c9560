//! `--families`: families of models against each other.

use std::{collections::BTreeSet, str::FromStr};

use anyhow::{Result, bail, ensure};
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

/// The models of each family, as places in `names`: the names of all measured models.
///
/// # Errors
/// If there is one family, a family names a model that is not measured or might be several, or a model is in two families.
pub(crate) fn members(families: &[FamilyArg], names: &[&str]) -> Result<Vec<Vec<usize>>> {
    ensure!(
        families.len() != 1,
        "--families has one family: nothing to compare it with"
    );
    let mut seen = BTreeSet::new();
    let members = families.iter().map(|own| {
        let places = own.models.iter().map(|model| {
            let place = place(names, model)?;
            ensure!(seen.insert(place), "--families has {model} twice");
            Ok(place)
        });
        places.collect()
    });
    members.collect()
}

/// The mean of each family.
///
/// # Errors
/// Those of [`members`], and if the models of a family cannot be compared.
pub(crate) fn means(
    families: &[FamilyArg],
    findings: &[ModelFindings],
) -> Result<Vec<ModelFindings>> {
    let names: Vec<&str> = findings.iter().map(|own| &*own.header.model).collect();
    let members = members(families, &names)?;
    let means = families.iter().zip(members).map(|(own, places)| {
        let members: Vec<&ModelFindings> = places
            .iter()
            .filter_map(|place| findings.get(*place))
            .collect();
        Ok(family(&own.name, &members)?)
    });
    means.collect()
}

/// The place of a model by its name, or by that of its folder if only one has it.
fn place(names: &[&str], model: &str) -> Result<usize> {
    let model = model.trim_end_matches('/');
    let folder = |name: &str| name.rsplit('/').next().map(str::to_owned);
    let places = |is: &dyn Fn(&str) -> bool| -> Vec<usize> {
        let numbered = names.iter().enumerate();
        let chosen = numbered.filter(|(_, name)| is(name.trim_end_matches('/')));
        chosen.map(|(place, _)| place).collect()
    };
    let mut found = places(&|name| name == model);
    if found.is_empty() {
        found = places(&|name| folder(name) == folder(model));
    }
    let known = names.join(", ");
    match found.as_slice() {
        [place] => Ok(*place),
        [] => bail!("--families: no model `{model}` among {known}"),
        _ => bail!("--families: `{model}` is several models of {known}; give the whole path"),
    }
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
        // The whole name comes before the folder's.
        let found = members(&families(&["first=y/a", "second=a"]), &["x/a", "y/a", "a"]);
        assert_eq!(found.unwrap(), [[1], [2]]);
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
        let error = members(&families(&["first=a", "second=b"]), &["x/a", "y/a", "b"]).unwrap_err();
        assert!(error.to_string().contains("whole path"), "{error}");
        for text in ["a", "=a", "first=", "first=a,,b"] {
            assert!(text.parse::<FamilyArg>().is_err(), "{text}");
        }
    }
}
