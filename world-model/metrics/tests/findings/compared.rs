use wm_metrics::findings::{
    Better, FindingsError, Metric, ModelFindings, Section, Suite, Verdict, compare, family,
};

use super::sample::findings;

/// A model with one figure that has `values` by unit.
fn with(better: Better, values: &[f64]) -> ModelFindings {
    let mut section = Section::new(Suite::Control);
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let samples = values.iter().enumerate();
    let metric = Metric {
        samples: samples
            .map(|(unit, value)| (format!("unit {unit}"), *value))
            .collect(),
        ..Metric::plain(mean, values.len(), better, "")
    };
    section.metric("error", metric);
    ModelFindings {
        sections: vec![section],
        ..findings("model", 0)
    }
}

const NAME: &str = "control.error";

#[test]
fn comparison_matches_manual_calculation() {
    // Differences 1, 2, 4: of 8 sign patterns one has a sum of at least 7, all have one of at least -7.
    let (a, b) = ([1.0, 1.0, 1.0], [2.0, 3.0, 5.0]);
    let of = |better| {
        compare(&with(better, &a), &with(better, &b))
            .unwrap()
            .differences[NAME]
            .clone()
    };
    let higher = of(Better::Higher);
    assert!((higher.difference - 7.0 / 3.0).abs() < 1e-12);
    assert_eq!((higher.baseline, higher.n), (1.0, 3));
    assert_eq!((higher.p, higher.p_is_exact), (Some(1.0 / 8.0), true));
    let interval = higher.interval.unwrap();
    assert_eq!((interval.low, interval.high), (1.0, 4.0));
    // The interval excludes 0, but three pairs are too few.
    assert_eq!(higher.verdict, Verdict::Unclear);
    assert_eq!(of(Better::Lower).p, Some(1.0));
    assert_eq!(of(Better::Neither).p, None);
}

/// Ratios and correlations of all units together.
#[test]
fn other_figures_are_compared_by_their_resamples() {
    let of = |n: usize, value: f64, replicates: &[f64]| {
        let mut findings = with(Better::Lower, &[1.0]);
        for section in &mut findings.sections {
            for metric in section.metrics.values_mut() {
                metric.samples.clear();
                (metric.n, metric.value) = (n, value);
                metric.replicates = replicates.to_vec();
            }
        }
        findings
    };
    let compared =
        |a: &ModelFindings, b: &ModelFindings| compare(a, b).unwrap().differences[NAME].clone();
    let ours = of(8, 0.5, &[0.4, 0.5, 0.6, 0.7]);
    // The models' own intervals overlap; with equal draws, one is always 0.2 lower.
    let theirs = of(8, 0.3, &[0.2, 0.3, 0.4, 0.5]);
    let found = compared(&ours, &theirs);
    let interval = found.interval.unwrap();
    assert!((interval.low + 0.2).abs() < 1e-9 && (interval.high + 0.2).abs() < 1e-9);
    assert_eq!((found.n, found.p, found.p_is_exact), (8, Some(0.0), false));
    assert_eq!(found.verdict, Verdict::Better);
    assert_eq!(compared(&theirs, &ours).verdict, Verdict::Worse);
    let few = (of(5, 0.5, &[0.4, 0.5]), of(5, 0.3, &[0.2, 0.3]));
    assert_eq!(compared(&few.0, &few.1).verdict, Verdict::Untested);
    let other = of(7, 0.3, &[0.2, 0.3, 0.4, 0.5]);
    assert_eq!(compared(&ours, &other).interval, None);
}

#[test]
fn six_pairs_of_one_direction_suffice() {
    let (a, b) = ([1.0; 6], [1.5, 1.6, 1.7, 1.8, 1.9, 2.0]);
    let verdict = |better, a: &[f64], b: &[f64]| {
        let found = compare(&with(better, a), &with(better, b)).unwrap();
        (found.differences[NAME].p, found.differences[NAME].verdict)
    };
    assert_eq!(
        verdict(Better::Higher, &a, &b),
        (Some(1.0 / 64.0), Verdict::Better)
    );
    assert_eq!(verdict(Better::Higher, &b, &a), (Some(1.0), Verdict::Worse));
    assert_eq!(
        verdict(Better::Lower, &b, &a),
        (Some(1.0 / 64.0), Verdict::Better)
    );
    assert_eq!(verdict(Better::Lower, &a, &b), (Some(1.0), Verdict::Worse));
    assert_eq!(verdict(Better::Neither, &a, &b), (None, Verdict::Differs));
    assert_eq!(
        verdict(Better::Lower, &a, &a),
        (Some(1.0), Verdict::Unclear)
    );
}

#[test]
fn only_units_of_the_same_name_are_pairs() {
    let a = with(Better::Lower, &[1.0, 2.0, 3.0]);
    let found = compare(&a, &with(Better::Lower, &[1.0, 2.0, 5.0, 100.0])).unwrap();
    let difference = &found.differences[NAME];
    assert_eq!((difference.n, difference.difference), (3, 2.0 / 3.0));
    // One pair has no spread.
    let found = compare(&a, &with(Better::Lower, &[4.0])).unwrap();
    let difference = &found.differences[NAME];
    assert_eq!((difference.n, difference.difference), (1, 2.0));
    assert_eq!((difference.interval, difference.p), (None, None));
    assert_eq!(difference.verdict, Verdict::Untested);
}

#[test]
fn missing_and_incompatible_figures_are_reported() {
    let a = findings("a", 0);
    let mut b = findings("b", 1);
    let psnr = b.sections[0].metrics.get_mut("fidelity.psnr").unwrap();
    psnr.unit = "bel".into();
    let found = compare(&a, &b).unwrap();
    assert!(!found.differences.contains_key("fidelity.psnr"));
    assert_eq!(found.absent["fidelity.psnr"], "in \"dB\" and in \"bel\"");
    assert_eq!(
        found.absent["policy.ood_success_rate"],
        "not measured for a"
    );
    assert!(!found.differences.contains_key("fidelity.not_a_number"));
}

#[test]
fn different_settings_are_rejected_by_name() {
    let a = findings("a", 0);
    let mut b = findings("b", 1);
    b.header.seed = 8;
    b.header.data_digest = "other".into();
    b.header.settings["solver"]["steps"] = 9.into();
    b.header.settings["history"] = 2.0.into();
    b.header.settings["extra"] = "x".into();
    let error = compare(&a, &b).unwrap_err();
    let FindingsError::NotComparable { mismatches, .. } = &error else {
        panic!("{error}");
    };
    let what: Vec<&str> = mismatches.iter().map(|one| one.what.as_str()).collect();
    assert_eq!(
        what,
        ["data", "seed", "settings.extra", "settings.solver.steps"]
    );
    let error = error.to_string();
    assert!(error.contains("seed is 8, expected 7"), "{error}");
    assert!(
        error.contains("settings.solver.steps is 9, expected 8"),
        "{error}"
    );
    assert!(wm_metrics::findings::html("", &[a.clone(), b.clone()]).is_err());
    assert!(wm_metrics::findings::json(&[a, b]).is_err());
}

/// The paper's family-level rows: the mean of each family by unit, then paired over units.
#[test]
fn families_are_compared_by_their_means() {
    let of = |values: &[f64]| with(Better::Higher, values);
    let reconstruction = [of(&[1.0, 2.0, 3.0]), of(&[3.0, 2.0, 1.0])];
    let semantic = [of(&[4.0, 3.0, 5.0])];
    let mean =
        |name: &str, members: &[ModelFindings]| family(name, &members.iter().collect::<Vec<_>>());
    let baseline = mean("reconstruction", &reconstruction).unwrap();
    let found = compare(&baseline, &mean("semantic", &semantic).unwrap()).unwrap();
    let names = [&found.baseline.model, &found.model.model];
    assert_eq!(names, ["reconstruction", "semantic"]);
    let difference = &found.differences[NAME];
    // 4 - 2, 3 - 2, 5 - 2.
    assert_eq!(
        (difference.baseline, difference.difference, difference.n),
        (2.0, 2.0, 3)
    );
    assert_eq!(
        (difference.p, difference.p_is_exact),
        (Some(1.0 / 8.0), true)
    );

    // Units that a member lacks have no mean.
    let shorter = mean("shorter", &[of(&[1.0, 2.0, 3.0]), of(&[3.0, 2.0])]).unwrap();
    assert_eq!(shorter.metrics()[NAME].samples.len(), 2);
    // Figures that a member lacks neither.
    let mut without = of(&[1.0]);
    without.sections.clear();
    let missing = mean("missing", &[of(&[1.0]), without]).unwrap();
    assert!(missing.metrics().is_empty());
}

#[test]
fn families_need_comparable_members() {
    let error = family("none", &[]).unwrap_err().to_string();
    assert!(error.contains("none"), "{error}");
    let (a, mut b) = (with(Better::Higher, &[1.0]), with(Better::Higher, &[1.0]));
    b.header.seed += 1;
    let error = family("mixed", &[&a, &b]).unwrap_err().to_string();
    assert!(error.contains("seed"), "{error}");
}
