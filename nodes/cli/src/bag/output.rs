//! The output of commands that write a bag.

use crate::output::print;
use anyhow::Result;
use std::process::ExitCode;
use wm_bag::{BagSummary, BagWarning};
use wm_robot_nodes::ending::Ending;

/// Prints the size and path of the new bag.
pub(super) fn print_size(bag: &BagSummary) -> Result<()> {
    print(format_args!(
        "wrote {} message(s) of {} topic(s) to {}\n",
        bag.message_count,
        bag.topics.len(),
        bag.path.display()
    ))
}

/// Prints the warnings of the old bag, and returns the exit code.
pub(super) fn print_warnings(warnings: &[BagWarning]) -> Result<ExitCode> {
    for warning in warnings {
        print(format_args!("Warning: {warning}\n"))?;
    }
    let is_lost = warnings.iter().any(BagWarning::is_loss);
    Ok(Ending::lost_if(is_lost).into())
}
