//! The processor.

use crate::{
    DoctorError, Finding,
    control_group::{ControlGroups, Quota},
    system_file::{read, read_if_there},
};

const CHECK: &str = "processor";

/// Instructions that the models' fast kernels need.
const KERNELS: [&str; 2] = ["avx2", "fma"];
/// Instructions that are faster still.
const FASTER: [(&str, &str); 3] = [
    ("avx512f", "AVX-512"),
    ("avx512_vnni", "VNNI"),
    ("avx512_bf16", "bf16"),
];
/// Drivers whose `powersave` follows the load.
const DYNAMIC: [&str; 2] = ["intel_pstate", "amd-pstate-epp"];

/// The processors of this process.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Processor {
    /// The vendor's name.
    pub model: String,
    /// How many this process may use, by its affinity and its quota, rounded down.
    pub count: usize,
    /// Share of processor time by the control group.
    pub quota: Option<Quota>,
    /// `RAYON_NUM_THREADS`: threads of the models.
    pub threads: Option<usize>,
    /// `flags` of x86; `None` elsewhere.
    pub flags: Option<Vec<String>>,
    /// Driver and governor of the frequency; `None` in a virtual machine.
    pub governor: Option<(String, String)>,
    /// Runnable processes, averaged over the last minute.
    pub load: f64,
}

impl Processor {
    pub(crate) fn look() -> Result<Self, DoctorError> {
        let frequency = "/sys/devices/system/cpu/cpu0/cpufreq";
        let one = |name: &str| read_if_there(format!("{frequency}/{name}"));
        Ok(Self {
            count: std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
            quota: ControlGroups::look().and_then(|groups| groups.quota()),
            threads: std::env::var("RAYON_NUM_THREADS")
                .ok()
                .and_then(|number| number.parse().ok()),
            governor: one("scaling_driver").zip(one("scaling_governor")),
            load: load_of(&read("/proc/loadavg")?),
            ..Self::of_cpuinfo(&read("/proc/cpuinfo")?)
        })
    }

    /// Model and flags, from the text of `/proc/cpuinfo`.
    fn of_cpuinfo(text: &str) -> Self {
        let value = |key: &str| {
            let mut lines = text.lines().filter_map(|line| line.split_once(':'));
            lines.find_map(|(name, value)| (name.trim() == key).then(|| value.trim().to_owned()))
        };
        let words = |text: String| text.split_whitespace().map(str::to_owned).collect();
        Self {
            model: value("model name").unwrap_or_else(|| "a processor".to_owned()),
            flags: value("flags").map(words),
            ..Self::default()
        }
    }

    fn has(&self, flag: &str) -> bool {
        let mut flags = self.flags.iter().flatten();
        flags.any(|found| found == flag)
    }
}

/// The first value of `/proc/loadavg`.
fn load_of(text: &str) -> f64 {
    let first = text.split_whitespace().next();
    first.and_then(|word| word.parse().ok()).unwrap_or(0.0)
}

pub(crate) fn check(processor: &Processor) -> Vec<Finding> {
    let Processor {
        model, count, load, ..
    } = processor;
    let mut findings = Vec::new();
    let missing: Vec<_> = KERNELS
        .into_iter()
        .filter(|flag| !processor.has(flag))
        .collect();
    if processor.flags.is_some() && !missing.is_empty() {
        findings.push(
            Finding::warning(CHECK, format!("{model}: no {}", missing.join(", ")))
                .because("the models' fast kernels need AVX2 and FMA; without them every node is several times slower")
                .fix("use a processor of 2013 or later, or, in a virtual machine, one with host-passthrough"),
        );
    } else {
        let faster = FASTER.into_iter().filter(|(flag, _)| processor.has(flag));
        let names: Vec<_> = faster.map(|(_, name)| name).collect();
        let with = match names.is_empty() {
            true => String::new(),
            false => format!(", with {}", names.join(", ")),
        };
        let quota = processor.quota.as_ref().map_or_else(String::new, |quota| {
            format!(" (quota of {:.1})", quota.processors)
        });
        findings.push(Finding::ok(
            CHECK,
            format!("{model}, {count} usable{quota}{with}"),
        ));
    }
    if let Some(quota) = processor.quota.as_ref().filter(|quota| quota.throttled > 0) {
        findings.push(
            Finding::warning(
                CHECK,
                format!(
                    "the control group's quota of {:.1} processors has stopped its processes {} times",
                    quota.processors, quota.throttled
                ),
            )
            .because("a node that is stopped is late by most of a period, 100 ms if nobody set another")
            .fix("raise the quota (CPUQuota of systemd, docker --cpus), or bind the nodes to processors of their own (taskset, docker --cpuset-cpus)"),
        );
    }
    if let Some(threads) = processor.threads.filter(|threads| threads > count) {
        findings.push(
            Finding::warning(
                CHECK,
                format!("{threads} threads by RAYON_NUM_THREADS on {count} usable processors"),
            )
            .because("threads of a model wait for each other: one that has no processor stops all")
            .fix("unset RAYON_NUM_THREADS, or give this process more processors"),
        );
    }
    if *count < 2 {
        findings.push(
            Finding::warning(CHECK, "one usable processor")
                .because("encoder, predictor, decoder and planner compute at the same time")
                .fix("give this process more processors (taskset, docker --cpus, CPUQuota of systemd)"),
        );
    }
    // as many processes as processors are no overload
    if *load > *count as f64 + 0.5 {
        findings.push(
            Finding::warning(
                CHECK,
                format!("{load:.1} runnable processes on {count} processors"),
            )
            .because("these measurements are too slow, and predictions will be late")
            .fix("end other programs (top shows them), unless these are the nodes themselves"),
        );
    }
    if let Some((driver, governor)) = &processor.governor
        && governor == "powersave"
        && !DYNAMIC.contains(&driver.as_str())
    {
        findings.push(
            Finding::warning(
                CHECK,
                format!("the frequency governor is {governor} ({driver})"),
            )
            .because("the processor stays at its lowest frequency")
            .fix(
                "echo performance | sudo tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor",
            ),
        );
    }
    findings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Level;

    const CPUINFO: &str =
        "processor\t: 0\nmodel name\t: AMD EPYC 7713\nflags\t\t: fpu avx2 fma\n\nprocessor\t: 1\n";

    fn levels(processor: &Processor) -> Vec<Level> {
        check(processor)
            .iter()
            .map(|finding| finding.level)
            .collect()
    }

    #[test]
    fn model_and_flags_are_read() {
        let read = Processor::of_cpuinfo(CPUINFO);
        assert_eq!(read.model, "AMD EPYC 7713");
        assert!(read.has("fma") && !read.has("avx512f"));
        assert_eq!(Processor::of_cpuinfo("").flags, None);
        assert_eq!(load_of("2.50 1.00 0.50 3/200 1\n"), 2.5);
    }

    #[test]
    fn slow_processors_are_reported() {
        let good = Processor {
            count: 4,
            load: 0.5,
            governor: Some(("intel_pstate".into(), "powersave".into())),
            ..Processor::of_cpuinfo(CPUINFO)
        };
        assert_eq!(levels(&good), [Level::Ok]);
        // Arm has no such flags, but kernels of its own
        let arm = Processor {
            flags: None,
            ..good.clone()
        };
        assert_eq!(levels(&arm), [Level::Ok]);
        let old = Processor {
            flags: Some(vec!["sse2".into()]),
            ..good.clone()
        };
        assert!(check(&old)[0].what.contains("no avx2, fma"));
        let busy = Processor {
            load: 5.0,
            ..good.clone()
        };
        assert_eq!(levels(&busy), [Level::Ok, Level::Warning]);
        let single = Processor {
            count: 1,
            ..good.clone()
        };
        assert_eq!(levels(&single), [Level::Ok, Level::Warning]);
        let throttled = Processor {
            quota: Some(Quota {
                processors: 1.5,
                throttled: 3,
            }),
            ..good.clone()
        };
        assert!(
            check(&throttled)[0]
                .what
                .ends_with("4 usable (quota of 1.5)")
        );
        assert!(
            check(&throttled)[1]
                .what
                .ends_with("stopped its processes 3 times")
        );
        let crowded = Processor {
            threads: Some(8),
            ..good.clone()
        };
        assert_eq!(levels(&crowded), [Level::Ok, Level::Warning]);
        let slow = Processor {
            governor: Some(("acpi-cpufreq".into(), "powersave".into())),
            ..good
        };
        assert!(
            check(&slow)[1]
                .fix
                .as_deref()
                .unwrap()
                .contains("scaling_governor")
        );
    }
}
