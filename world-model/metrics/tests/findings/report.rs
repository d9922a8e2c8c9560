use proptest::prelude::*;
use wm_metrics::findings::{
    Better, Curve, Metric, ModelFindings, Picture, Series, TextTable, Trajectories, html,
    model_card,
};

use super::{
    reading::{seen, tags},
    sample::{TITLE, about, findings},
};

fn three() -> [ModelFindings; 3] {
    ["sample-a", "sample-b", "sample-<script>"].map(|name| findings(name, name.len() as u64 % 3))
}

#[test]
fn report_has_all_findings_of_one_and_three_models() {
    for models in [&three()[..1], &three()] {
        let report = html(TITLE, models).unwrap();
        let (tags, seen) = (tags(&report), seen(&report));
        for model in models {
            let header = &model.header;
            assert!(seen.contains(&header.model) && seen.contains(&header.short_hash()));
            for (name, metric) in model.metrics() {
                assert!(seen.contains(name), "{name}");
                assert!(seen.contains(&metric.about), "{name}");
            }
            for (name, why) in model.absent() {
                assert!(seen.contains(name) && seen.contains(&why), "{name}: {why}");
            }
            for section in &model.sections {
                assert!(seen.contains(section.suite.question()));
                assert!(section.notes.iter().all(|note| seen.contains(note)));
                assert!(section.curves.iter().all(|one| seen.contains(&one.title)));
                assert!(section.tables.iter().all(|one| seen.contains(&one.title)));
                assert!(section.pictures.iter().all(|one| report.contains(&one.png)));
                for drawn in &section.trajectories {
                    assert!(seen.contains(&drawn.title) && seen.contains(&drawn.caption));
                }
            }
        }
        let count = |name: &str| tags.iter().filter(|tag| *tag == name).count();
        assert_eq!((count("html"), count("main"), count("h1")), (1, 1, 1));
        assert_eq!(count("img"), models.len());
        assert_eq!(count("script"), 0);
        assert!(seen.contains("7 ") && seen.contains("\"iterations\": 5"));
        // Nothing is fetched, and the file fits into a mail.
        let mut linked = report.replace("http-equiv", "");
        for picture in models.iter().flat_map(|model| &model.sections[0].pictures) {
            linked = linked.replace(&picture.png, "");
        }
        assert!(!linked.contains("http") && !linked.contains("url(") && !linked.contains("//"));
        assert!(report.len() < 120_000 * models.len(), "{}", report.len());
        assert!(!report.contains("NaN ") && !seen.contains("inf"));
        assert_eq!(report, html(TITLE, models).unwrap());
    }
}

#[test]
fn headings_are_ordered_and_tables_have_heads() {
    let report = html(TITLE, &three()).unwrap();
    let mut level = 0;
    for tag in tags(&report) {
        let digit = tag
            .strip_prefix('h')
            .and_then(|rest| rest.parse::<u32>().ok());
        if let Some(next) = digit {
            assert!(next <= level + 1, "h{next} after h{level}");
            level = next;
        }
    }
    for (start, _) in report.match_indices("<th") {
        let tag = &report[start..start + report[start..].find('>').unwrap()];
        assert!(
            tag.starts_with("<thead") || tag.contains("scope=\""),
            "{tag}"
        );
    }
    for (start, _) in report.match_indices("<svg") {
        let tag = &report[start..start + report[start..].find('>').unwrap()];
        assert!(
            tag.contains("aria-label=\"") || tag.contains("aria-hidden=\"true\""),
            "{tag}"
        );
    }
}

#[test]
fn common_lines_are_drawn_once_and_labels_are_unique() {
    let models = [
        findings("same", 0),
        findings("same", 1),
        findings("same", 1),
    ];
    let report = html(TITLE, &models).unwrap();
    let seen = seen(&report);
    assert!(seen.contains("same (3fa9c13f)") && seen.contains("same (b07e52b0), number 3"));
    assert!(!seen.contains("same (b07e52b0): last frame repeated"));
    assert!(seen.contains("last frame repeated"));
}

#[test]
fn paths_are_shortened_to_distinct_endings() {
    let models = [findings("/runs/a/model", 0), findings("/runs/b/model", 1)];
    let seen = seen(&html(TITLE, &models).unwrap());
    assert!(seen.contains("Is b/model better than a/model?"));
    assert!(seen.contains("/runs/a/model") && seen.contains("/runs/b/model"));
}

#[test]
fn report_without_findings_is_valid() {
    let report = html("None", &[]).unwrap();
    tags(&report);
    assert!(seen(&report).contains("Nothing was measured."));
    let mut empty = findings("empty", 0);
    empty.sections.clear();
    tags(&html("Empty", &[empty]).unwrap());
}

#[test]
fn undrawable_values_are_skipped() {
    let mut one = findings("odd", 0);
    let section = &mut one.sections[0];
    let odd = [f64::NAN, f64::INFINITY, 1e308, -1e308, 0.0, -0.0, 1e-310];
    let points: Vec<[f64; 2]> = odd.iter().flat_map(|x| odd.map(|y| [*x, y])).collect();
    section.curves.push(Curve {
        title: "odd".into(),
        x: String::new(),
        y: String::new(),
        series: vec![
            Series {
                name: String::new(),
                points: points.clone(),
                band: points.clone(),
            },
            Series {
                name: "none".into(),
                points: Vec::new(),
                band: Vec::new(),
            },
        ],
    });
    section.trajectories.push(Trajectories {
        title: "odd".into(),
        caption: String::new(),
        paths: vec![points, Vec::new()],
    });
    for value in odd {
        section.metric(
            &format!("odd_{value:e}"),
            Metric::plain(value, 1, Better::Higher, ""),
        );
    }
    let report = html("odd", &[one.clone(), one]).unwrap();
    tags(&report);
    for attribute in [" d=\"", " x=\"", " y=\""] {
        for (start, _) in report.match_indices(attribute) {
            let value = report[start + attribute.len()..].split('"').next().unwrap();
            assert!(!value.contains("NaN") && !value.contains("inf"), "{value}");
        }
    }
}

#[test]
fn long_curve_does_not_make_a_long_file() {
    let mut one = findings("long", 0);
    let points: Vec<[f64; 2]> = (0..200_000)
        .map(|i| [f64::from(i), f64::from(i % 97)])
        .collect();
    one.sections[0].curves[0].series[0].points = points.clone();
    one.sections[1].trajectories[0].paths = vec![points; 300];
    let report = html(TITLE, &[one]).unwrap();
    assert!(report.len() < 1_000_000, "{}", report.len());
}

#[test]
fn card_has_figures_limits_and_refused_uses() {
    let model = findings("sample-a", 0);
    let card = model_card(&model, &about());
    for (name, _) in model.metrics() {
        assert!(card.contains(&format!("`{name}`")), "{name}");
    }
    for (name, _) in model.absent() {
        assert!(card.contains(&format!("- `{name}`: ")), "{name}");
    }
    assert!(card.starts_with("---\nmodel_name: \"sample-a\"\n"));
    assert!(card.contains("0.507 | [0.496, 0.516] | 20"));
    assert!(card.contains("batch \\| accumulated") && card.contains("only safety check"));
    assert!(card.contains("```sh\nwm train recipe.yaml\nwm evaluate sample-a --seed 7\n```"));
    for line in card.lines().filter(|line| line.starts_with("| `")) {
        assert_eq!(line.replace("\\|", "").matches('|').count(), 6, "{line}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn no_text_becomes_markup(text in "\\PC*|.*[<>&\"'`|].*", title: String) {
        let mut one = findings(&text, 0);
        let section = &mut one.sections[0];
        section.notes.push(text.clone());
        section.metric(&text, Metric::plain(1.5, 3, Better::Neither, &text).in_unit(&text));
        section.absent(&text, text.clone());
        section.tables.push(TextTable {
            title: text.clone(),
            header: vec![text.clone(); 2],
            rows: vec![vec![text.clone(); 2]],
        });
        section.pictures.push(Picture { caption: text.clone(), png: text.clone() });
        section.curves[0].title.clone_from(&text);
        section.curves[0].y.clone_from(&text);
        section.curves[0].series[0].name.clone_from(&text);
        one.sections[1].trajectories[0].caption.clone_from(&text);
        one.header.data.push(text.clone());
        let plain = html("plain", &[findings("plain", 0)]).unwrap();
        let report = html(&title, &[one.clone()]).unwrap();
        let found = tags(&report);
        // Text adds no tags.
        prop_assert!(found.iter().all(|tag| tag != "script"));
        let kinds = |tags: &[String]| {
            let mut kinds = tags.to_vec();
            kinds.sort();
            kinds.dedup();
            kinds
        };
        prop_assert_eq!(kinds(&found), kinds(&tags(&plain)));
        if !text.chars().any(|c| c.is_control() || ('\u{2000}'..='\u{206f}').contains(&c)) {
            prop_assert!(seen(&report).contains(&text));
        }
        let card = model_card(&one, &about());
        for line in card.lines().filter(|line| line.starts_with("| `")) {
            let bars = line.replace("\\\\", "").replace("\\|", "");
            prop_assert_eq!(bars.matches('|').count(), 6, "{}", line);
        }
    }
}
