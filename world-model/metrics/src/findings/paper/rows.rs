//! The quantities of the paper's tables and figures, and the ranges that it prints.

/// A quantity of the paper.
pub(super) struct Row {
    /// Table or figure, and its section.
    pub place: &'static str,
    /// What the paper measures.
    pub quantity: &'static str,
    /// Name of the figure, with its suite. One that ends in `_` is followed by the name of a judge.
    pub figure: &'static str,
    /// Printed values of DiT-S, if there are any.
    pub printed: Option<Printed>,
}

/// Ranges over the paper's encoders with DiT-S and one view.
pub(super) struct Printed {
    /// Lowest and highest of VAE, VA-VAE and Cosmos.
    pub reconstruction: [&'static str; 2],
    /// Lowest and highest of V-JEPA 2.1, Web-DINO and SigLIP 2, with and without adapters of any width.
    pub semantic: [&'static str; 2],
}

const fn row(
    place: &'static str,
    quantity: &'static str,
    figure: &'static str,
    reconstruction: [&'static str; 2],
    semantic: [&'static str; 2],
) -> Row {
    Row {
        place,
        quantity,
        figure,
        printed: Some(Printed {
            reconstruction,
            semantic,
        }),
    }
}

const fn unprinted(place: &'static str, quantity: &'static str, figure: &'static str) -> Row {
    Row {
        place,
        quantity,
        figure,
        printed: None,
    }
}

const LOOKS: &str = "tables 3 and 8 (C.2)";
const WORLD_ARENA: &str = "tables 3 and 9 (C.2)";
const BEHAVIOUR: &str = "tables 1 and 10 (C.1)";
const UTILITY: &str = "tables 2 and 13 (C.3)";
const PROBE: &str = "tables 2 and 14 (C.3)";
const TRAJECTORIES: &str = "figures 2 and 10 (C.3)";

/// All quantities, in the order of the suites.
#[rustfmt::skip]
pub(super) const ROWS: &[Row] = &[
    row(LOOKS, "PSNR [dB]", "fidelity.psnr", ["16.97", "17.43"], ["17.42", "18.26"]),
    row(LOOKS, "PSNR, gap to the ceiling [dB]", "fidelity.psnr_gap", ["10.06", "16.65"], ["8.54", "11.09"]),
    row(LOOKS, "SSIM", "fidelity.ssim", [".608", ".688"], [".711", ".738"]),
    row("table 8, figures 4 and 9 (C.2)", "SSIM, gap to the ceiling", "fidelity.ssim_gap", [".210", ".256"], [".152", ".190"]),
    row(LOOKS, "LPIPS", "fidelity.lpips", [".218", ".245"], [".176", ".214"]),
    row("table 8, figure 9 (C.2)", "LPIPS, gap to the ceiling", "fidelity.lpips_gap", [".197", ".207"], [".124", ".160"]),
    row(LOOKS, "temporal LPIPS", "fidelity.t_lpips", [".0223", ".0264"], [".0185", ".0234"]),
    row("table 8 (C.2)", "temporal LPIPS, gap to the ceiling", "fidelity.t_lpips_gap", [".0184", ".0252"], [".0118", ".0190"]),
    row(LOOKS, "FID", "fidelity.fid", ["15.49", "17.43"], ["6.00", "14.25"]),
    row("table 8 (C.2)", "FID, gap to the ceiling", "fidelity.fid_gap", ["11.37", "16.63"], ["1.39", "3.37"]),
    row(LOOKS, "FVD", "fidelity.fvd", ["6.8", "8.5"], ["5.2", "10.9"]),
    row("table 8 (C.2)", "FVD, gap to the ceiling", "fidelity.fvd_gap", ["4.5", "7.0"], ["1.5", "3.1"]),
    row("table 8, figure 9 (C.2)", "coverage of tracked points (PCK; tables 1 and 10 print .707 to .735)", "fidelity.pck_coverage", [".544", ".565"], [".555", ".580"]),
    row(WORLD_ARENA, "image quality", "fidelity.image_quality", [".558", ".592"], [".546", ".581"]),
    row(WORLD_ARENA, "aesthetic quality", "fidelity.aesthetic_quality", [".463", ".467"], [".466", ".474"]),
    row(WORLD_ARENA, "subject consistency", "fidelity.subject_consistency", [".793", ".817"], [".838", ".861"]),
    row("table 9 (C.2)", "background consistency", "fidelity.background_consistency", [".946", ".950"], [".952", ".961"]),
    row("table 9 (C.2)", "photometric consistency", "fidelity.photometric_consistency", ["73.29", "96.26"], ["74.93", "103.86"]),
    row(WORLD_ARENA, "dynamic degree", "fidelity.dynamic_degree", [".765", ".813"], [".782", ".843"]),
    row(WORLD_ARENA, "flow score", "fidelity.flow_score", ["1.186", "1.511"], ["1.325", "1.653"]),
    row(WORLD_ARENA, "depth, absolute relative error", "fidelity.depth_abs_rel", [".390", ".638"], [".350", ".404"]),
    row(WORLD_ARENA, "JEPA similarity", "fidelity.jepa_similarity", [".517", ".871"], [".774", ".944"]),
    row("tables 1, 10, 12 and 15 (C.1)", "CEM error, k = 1", "control.cem_k1_error", [".097", ".112"], [".082", ".104"]),
    row(BEHAVIOUR, "CEM error, k = 4", "control.cem_k4_error", [".543", ".661"], [".424", ".555"]),
    row(UTILITY, "IDM r, k = 1, real latents", "latents.idm_k1_r_real", [".507", ".626"], [".772", ".829"]),
    row(UTILITY, "IDM r, k = 1, predicted latents", "latents.idm_k1_r_predicted", [".476", ".581"], [".697", ".781"]),
    row(UTILITY, "IDM r, k = 4, real latents", "latents.idm_k4_r_real", [".478", ".744"], [".793", ".865"]),
    row(UTILITY, "IDM r, k = 4, predicted latents", "latents.idm_k4_r_predicted", [".464", ".719"], [".757", ".840"]),
    row(PROBE, "success probe, balanced accuracy, real latents", "latents.success_balanced_accuracy_real", [".835", ".868"], [".903", ".906"]),
    row(PROBE, "success probe, balanced accuracy, predicted latents", "latents.success_balanced_accuracy_predicted", [".716", ".744"], [".788", ".823"]),
    row("table 14 (C.3)", "success probe, AUC, real latents", "latents.success_auc_real", [".917", ".938"], [".961", ".963"]),
    row("table 14 (C.3)", "success probe, drop of the accuracy", "latents.success_drop", [".119", ".128"], [".080", ".118"]),
    unprinted(TRAJECTORIES, "first canonical correlation, real latents", "latents.idm_k1_cca_rho1_real"),
    unprinted(TRAJECTORIES, "second canonical correlation, real latents", "latents.idm_k1_cca_rho2_real"),
    unprinted(TRAJECTORIES, "eta, real latents", "latents.idm_k1_cca_eta_real"),
    row("tables 1, 10, 11 and 12 (C.1)", "consensus success rate", "policy.consensus_success", [".169", ".244"], [".194", ".362"]),
    row(BEHAVIOUR, "success rate by one judge", "policy.success_by_", [".350", ".425"], [".500", ".625"]),
    row(BEHAVIOUR, "success rate by one judge, OOD distractor", "policy.ood_distractor_success_by_", [".250", ".362"], [".487", ".588"]),
    row(BEHAVIOUR, "success rate by one judge, OOD instruction", "policy.ood_instruction_success_by_", [".200", ".275"], [".250", ".400"]),
    row("table 12 (C.1)", "success rate, OOD pooled, mean of the judges", "policy.ood_mean_rater_success", [".225", ".319"], [".381", ".487"]),
    row(BEHAVIOUR, "interaction quality, 1 to 5", "policy.interaction_quality", ["3.22", "3.32"], ["3.31", "3.52"]),
    row(BEHAVIOUR, "instruction following, 1 to 5", "policy.instruction_following", ["3.42", "3.51"], ["3.50", "3.85"]),
    unprinted("figure 8 (C.5)", "Cohen's kappa of two judges", "policy.kappa_"),
    unprinted("table 4 (B)", "parameters of the transition model", "cost.transition_parameters"),
    unprinted("table 4 (B)", "operations of a transition [GFLOP]", "cost.transition_gflops"),
];
