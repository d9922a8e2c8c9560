use indicatif::{ProgressBar, ProgressStyle};

/// A bar for `total` things to do; where none is seen, a line.
#[must_use]
pub fn progress_bar(verb: &str, things: &str, total: usize) -> ProgressBar {
    let template = format!("{verb} {{bar:40}} {{pos}}/{{len}} {things}, {{eta}} left");
    let style =
        ProgressStyle::with_template(&template).unwrap_or_else(|_| ProgressStyle::default_bar());
    let bar = ProgressBar::new(total as u64).with_style(style);
    if bar.is_hidden() {
        println!("{verb} {total} {things}");
    }
    bar
}
