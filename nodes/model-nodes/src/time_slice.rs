//! Short time slices: how soon a thread that wakes up gets a processor.

use std::io;

/// The shortest slice that Linux gives: a thread that requests it gets a processor soon.
const SHORT_NS: u64 = 100_000;

/// Requests that the calling thread, when it wakes up, preempts threads with the usual, longer slice.
///
/// From 6.12 on, Linux lets a running thread have its slice of a few milliseconds even if a thread of a higher priority
/// wakes up, but not if that one asked for a shorter slice (sched_setattr(2), EEVDF). Its share of the processor stays
/// the same. Older versions ignore the wish, and so do threads with a real-time policy.
pub(crate) fn shorten() {
    if let Err(error) = try_shorten() {
        tracing::debug!("no shorter time slices: {error}");
    }
}

#[cfg(target_os = "linux")]
fn try_shorten() -> io::Result<()> {
    let mut attributes = attributes()?;
    if attributes.sched_policy == libc::SCHED_OTHER as u32 {
        attributes.sched_runtime = SHORT_NS;
        // SAFETY: the kernel reads as many bytes as the structure's field `size` says; it has no pointers.
        checked(unsafe { libc::syscall(libc::SYS_sched_setattr, 0, &raw const attributes, 0) })?;
    }
    Ok(())
}

#[cfg(target_os = "linux")]
fn attributes() -> io::Result<libc::sched_attr> {
    const SIZE: u32 = size_of::<libc::sched_attr>() as u32;
    // SAFETY: integers, of which any may be zero.
    let mut attributes: libc::sched_attr = unsafe { std::mem::zeroed() };
    // SAFETY: the kernel writes at most SIZE bytes, and sets `size` to how many it knows.
    checked(unsafe { libc::syscall(libc::SYS_sched_getattr, 0, &raw mut attributes, SIZE, 0) })?;
    Ok(attributes)
}

#[cfg(target_os = "linux")]
fn checked(result: libc::c_long) -> io::Result<()> {
    match result {
        0 => Ok(()),
        _ => Err(io::Error::last_os_error()),
    }
}

#[cfg(not(target_os = "linux"))]
fn try_shorten() -> io::Result<()> {
    Err(io::ErrorKind::Unsupported.into())
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn priority_and_policy_stay() {
        std::thread::spawn(|| {
            rustix::process::nice(2).unwrap();
            let before = attributes().unwrap();
            try_shorten().unwrap();
            let after = attributes().unwrap();
            assert_eq!(
                (after.sched_policy, after.sched_nice),
                (before.sched_policy, before.sched_nice)
            );
            // What the kernel says of slices that were asked for: nothing before 6.12.
            assert!([SHORT_NS, before.sched_runtime].contains(&after.sched_runtime));
        })
        .join()
        .unwrap();
    }
}
