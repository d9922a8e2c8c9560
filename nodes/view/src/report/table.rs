//! The report as a table for the terminal, and as Markdown.

use super::figures::{Percentiles, Report, StepFigures};
use super::scorer::LATE_PICTURE;
use super::strip::STRIP;
use std::fmt::Write as _;

const HEADINGS: [&str; 11] = [
    "k",
    "n",
    "PSNR dB",
    "(held)",
    "SSIM",
    "(held)",
    "latent ratio",
    "p50 ms",
    "p95 ms",
    "p99 ms",
    "missing",
];

/// The report as lines of text; "held" is the persistence baseline.
#[must_use]
pub fn terminal_table(report: &Report) -> String {
    let rows: Vec<[String; 11]> = report.steps.iter().map(row).collect();
    let mut widths = HEADINGS.map(str::len);
    for row in &rows {
        for (width, cell) in widths.iter_mut().zip(row) {
            *width = (*width).max(cell.chars().count());
        }
    }
    let mut text = report
        .doubt()
        .map_or_else(String::new, |doubt| format!("{doubt}\n"));
    text.push_str(&heading(report));
    if report.steps.is_empty() {
        text.push_str(&remarks(report, ""));
        return text;
    }
    let line = |cells: &mut dyn Iterator<Item = &str>| {
        let padded: Vec<String> = cells
            .zip(widths)
            .map(|(cell, width)| format!("{cell:>width$}"))
            .collect();
        padded.join("  ")
    };
    // writing to a String cannot fail
    writeln!(text, "{}", line(&mut HEADINGS.iter().copied())).ok();
    for row in &rows {
        writeln!(text, "{}", line(&mut row.iter().map(String::as_str))).ok();
    }
    text.push_str(&remarks(report, ""));
    text
}

/// The report as Markdown, with the strip if there is one.
pub(super) fn markdown(report: &Report, has_strip: bool) -> String {
    let doubt = report.doubt();
    let doubt = doubt.map_or_else(String::new, |doubt| format!("**{doubt}**\n\n"));
    let mut text = format!("{doubt}# Predictions and reality\n\n{}\n", heading(report));
    // writing to a String cannot fail
    if !report.steps.is_empty() {
        writeln!(
            text,
            "| {} |\n|{}",
            HEADINGS.join(" | "),
            "---:|".repeat(HEADINGS.len())
        )
        .ok();
    }
    for step in &report.steps {
        writeln!(text, "| {} |", row(step).join(" | ")).ok();
    }
    writeln!(text, "\n{}", remarks(report, "- ")).ok();
    if has_strip {
        writeln!(
            text,
            "![real, predicted and difference over the steps]({STRIP})"
        )
        .ok();
    }
    text
}

fn is_compared(report: &Report) -> bool {
    report.steps.iter().any(|step| step.compared > 0)
}

fn heading(report: &Report) -> String {
    if report.steps.is_empty() {
        let (source, frames, rate) = (&report.source, report.frames, report.frame_rate_hz);
        return format!("{source}: {frames} frames at {rate:.2} Hz, no prediction\n");
    }
    let hash: String = report.model_hash.chars().take(12).collect();
    format!(
        "{}: {} frames at {:.2} Hz, {} observations, model {} {hash}, K = {} steps of {:.2} s\n",
        report.source,
        report.frames,
        report.frame_rate_hz,
        report.observations,
        report.model,
        report.horizon,
        report.step_period_s,
    )
}

fn row(step: &StepFigures) -> [String; 11] {
    let number = |value: Option<f64>, digits: usize| match value {
        Some(value) => format!("{value:.digits$}"),
        None => "-".to_owned(),
    };
    let time = |pick: fn(&Percentiles) -> f64| number(step.received_latency.as_ref().map(pick), 1);
    [
        step.step.to_string(),
        step.compared.to_string(),
        number(step.psnr_db, 2),
        number(step.persistence_psnr_db, 2),
        number(step.ssim, 3),
        number(step.persistence_ssim, 3),
        number(step.latent_error_ratio, 3),
        time(|latency| latency.p50_ms),
        time(|latency| latency.p95_ms),
        time(|latency| latency.p99_ms),
        step.missing.to_string(),
    ]
}

fn remarks(report: &Report, bullet: &str) -> String {
    let mut text = String::new();
    let mut add = |line: String| {
        // writing to a String cannot fail
        writeln!(text, "{bullet}{line}").ok();
    };
    if !report.steps.is_empty() {
        add("n: pictures compared with the frame of the same time; held: the persistence baseline, which repeats the \
             last observed frame; latent ratio: latent error of the model over that of the persistence baseline; ms: \
             from the capture of the observed frame to the arrival of the prediction"
            .to_owned());
    }
    if !report.steps.is_empty() && !is_compared(report) {
        let late = report
            .drops
            .iter()
            .find(|drops| drops.reason == LATE_PICTURE);
        add(match late {
            Some(late) => format!(
                "nothing was compared, and there is no {STRIP}: {} predicted pictures came too late, since this machine \
                 has too much to do; end other programs, or take a smaller model",
                late.total
            ),
            None => format!(
                "nothing was compared, and there is no {STRIP}: no predicted picture has a frame of the same time; an \
                 env's bag has no predicted pictures, since its frames are the predictions"
            ),
        });
    }
    if let Some(plans) = &report.plans {
        let times = plans.time_taken.unwrap_or_default();
        add(format!(
            "{} plans in p50 {:.0} ms, p95 {:.0} ms; {} cut short by the deadline; cost {:.3} first, {:.3} last",
            plans.plans,
            times.p50_ms,
            times.p95_ms,
            plans.deadline_cuts,
            plans.first_cost,
            plans.last_cost
        ));
    }
    if report.drops.is_empty() {
        add("drops: none".to_owned());
    }
    report.losses().for_each(add);
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::figures::Drops;

    fn report() -> Report {
        let latency = Percentiles {
            n: 9,
            p50_ms: 40.04,
            p95_ms: 61.0,
            p99_ms: 99.9,
            max_ms: 100.0,
        };
        let step = StepFigures {
            step: 1,
            compared: 9,
            psnr_db: Some(28.456),
            received_latency: Some(latency),
            ..StepFigures::default()
        };
        let drops = vec![Drops {
            node: "wm/encoder".to_owned(),
            reason: "late".to_owned(),
            total: 2,
        }];
        Report {
            source: "live".to_owned(),
            steps: vec![step],
            drops,
            skips: vec![Drops {
                node: "wm/predictor".to_owned(),
                reason: "pace".to_owned(),
                total: 35,
            }],
            ..Report::default()
        }
    }

    #[test]
    fn columns_line_up() {
        let table = terminal_table(&report());
        let lines: Vec<&str> = table.lines().collect();
        assert_eq!(lines[1].len(), lines[2].len());
        assert!(
            lines[2].contains("28.46") && lines[2].contains("40.0") && lines[2].contains('-'),
            "{table}"
        );
        assert!(table.contains("dropped by wm/encoder: 2 (late)"));
        assert!(table.contains("skipped on purpose by wm/predictor: 35 (pace)"));
    }

    #[test]
    fn without_predictions_losses_replace_the_table() {
        let empty = Report {
            frames: 50,
            frame_rate_hz: 5.0,
            steps: Vec::new(),
            ..report()
        };
        for text in [terminal_table(&empty), markdown(&empty, false)] {
            assert!(
                text.contains("50 frames at 5.00 Hz, no prediction"),
                "{text}"
            );
            assert!(
                !text.contains("PSNR") && text.contains("wm/encoder: 2"),
                "{text}"
            );
        }
        let words = empty.frames_in_words();
        assert!(words.contains("by wm/predictor: 35 (pace)"), "{words}");
        assert!(!words.contains("frame_period"), "{words}");
        let slow = Report {
            frame_rate_hz: 2.0,
            ..empty
        };
        assert!(slow.frames_in_words().contains("to 0.500 s"));
    }

    #[test]
    fn late_pictures_are_named_as_the_reason() {
        let mut report = report();
        report.steps[0].compared = 0;
        assert!(terminal_table(&report).contains("an env's bag"));
        report.drops[0].reason = LATE_PICTURE.to_owned();
        let text = terminal_table(&report);
        assert!(
            text.contains("no strip.png: 2 predicted pictures came too late"),
            "{text}"
        );
    }

    #[test]
    fn markdown_has_a_cell_for_every_heading() {
        let text = markdown(&report(), true);
        let rows: Vec<&str> = text.lines().filter(|line| line.starts_with('|')).collect();
        assert_eq!(rows.len(), 3);
        for row in rows {
            assert_eq!(row.matches('|').count(), HEADINGS.len() + 1, "{row}");
        }
        assert!(text.contains("strip.png"));
        assert!(!markdown(&report(), false).contains("strip.png"));
    }

    #[test]
    fn useless_predictions_are_named_in_the_first_line() {
        let mut report = report();
        report.steps[0].persistence_psnr_db = Some(20.0);
        assert!(!markdown(&report, false).contains("no better"));
        report.steps[0].persistence_psnr_db = Some(31.1);
        for text in [terminal_table(&report), markdown(&report, false)] {
            let first = text.lines().next().unwrap();
            assert!(
                first.contains("PSNR 28.5 dB one step ahead against 31.1 dB"),
                "{text}"
            );
        }
        let doubts = |change: fn(&mut StepFigures)| {
            let mut report = report.clone();
            change(&mut report.steps[0]);
            report.doubt().is_some()
        };
        assert!(doubts(|_| {}));
        // One picture is not enough for a judgement, however many predictions there are; nor is a still scene.
        assert!(!doubts(
            |first| (first.compared, first.predictions) = (1, 50)
        ));
        assert!(!doubts(|first| first.persistence_psnr_db = Some(60.0)));
        report.steps[0].persistence_psnr_db = None;
        report.steps[0].latent_error_ratio = Some(2.1);
        assert!(terminal_table(&report).starts_with("The predictions are no better"));
    }
}
