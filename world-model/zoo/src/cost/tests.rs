use wm_model::transition::TransitionConfig;

use super::*;
use crate::success_probe::SuccessProbeConfig;
use crate::vit::SiglipTextConfig;

/// Asserts that a cost is (parameters in millions, GFLOPs), with three digits behind those of the paper's table.
fn assert_cost(what: &str, cost: Cost, (millions, gflops): (f64, f64), gflops_within: f64) {
    let found = cost.millions();
    // 1x1 convolutions around a latent, 0.004 M at most, are not in the paper's figures.
    assert!(
        (found - millions).abs() < 0.005,
        "{what}: {found} M, not {millions} M"
    );
    let found = cost.gflops();
    assert!(
        (found - gflops).abs() <= gflops_within,
        "{what}: {found} GFLOPs, not {gflops}"
    );
}

#[test]
fn figures_are_those_of_the_architecture() {
    // The paper, appendix B, table "Architecture size and compute", and the same sums with more digits.
    let sd3 = SdVaeConfig::sd3();
    let va_vae = VaVaeConfig::f16d32();
    let cosmos = CosmosConfig::ci16x16();
    for (what, cost, expected) in [
        ("SD3 encoder", sd3_encoder(&sd3), (34.274, 270.80)),
        ("SD3 decoder", sd3_decoder(&sd3), (49.545, 620.15)),
        ("VA-VAE encoder", va_vae_encoder(&va_vae), (28.413, 137.94)),
        ("VA-VAE decoder", va_vae_decoder(&va_vae), (41.418, 252.19)),
        ("Cosmos encoder", cosmos_encoder(&cosmos), (33.513, 47.60)),
        ("Cosmos decoder", cosmos_decoder(&cosmos), (47.995, 101.74)),
        (
            "pixel decoder",
            pixel_decoder(&PixelDecoderConfig::paper()),
            (177.041, 428.280),
        ),
        (
            "V-JEPA 2.1",
            vjepa(&VjepaConfig::vit_large()),
            (304.681, 154.62),
        ),
        (
            "Web-DINO",
            web_dino(&WebDinoConfig::vit_large()),
            (303.655, 155.73),
        ),
        (
            "SigLIP 2",
            siglip2(&SiglipVisionConfig::so400m()),
            (427.681, 211.85),
        ),
        (
            "S-VAE 1024",
            adapter(&SvaeConfig::paper(1024)),
            (38.110, 10.570),
        ),
        (
            "S-VAE 1152",
            adapter(&SvaeConfig::paper(1152)),
            (46.412, 12.797),
        ),
    ] {
        assert_cost(what, cost.unwrap(), expected, 0.006);
    }
}

#[test]
fn a_probe_costs_what_its_layers_do_by_hand() {
    // 27 layers of four projections and a feed-forward network, at 64 tokens.
    let tower = SiglipTextConfig::so400m();
    let layer = 4_usize * 1152 * 1152 + 2 * 1152 * 4304;
    let gflops = (2 * 27 * layer * 64) as f64 / 1e9;
    let cost = siglip2_text(&tower).unwrap();
    assert_cost("text tower", cost, (707.783, gflops), 1e-6);

    // Ten 384x384 of a block's twelve projections, and the feed-forward network, at 64 frames of 16 places; the keys and
    // values of the words at 64 tokens.
    let places = 64_usize * 16 * (1024 * 384 + 6 * (10 * 384 * 384 + 3 * 1024 * 384));
    let words = 64_usize * (1152 * 384 + 6 * 2 * 384 * 384);
    let gflops = (2 * (places + words + 384)) as f64 / 1e9;
    let cost = success_probe(&SuccessProbeConfig::paper(1024, 64), 64).unwrap();
    assert_cost("probe", cost, (18.577, gflops), 1e-6);
}

#[test]
fn transition_models_are_those_of_the_architecture() {
    for (latent, patch, wide, expected) in [
        ((32, 32, 16), 2, false, (910.082, 316.526)),
        ((16, 16, 16), 1, false, (909.984, 316.501)),
        ((16, 16, 32), 1, false, (910.016, 316.509)),
        ((16, 16, 96), 1, false, (910.148, 316.543)),
        ((16, 16, 1024), 1, true, (921.490, 318.652)),
        ((16, 16, 1152), 1, true, (921.884, 318.787)),
    ] {
        let cost = transition::large(latent, patch, wide).unwrap();
        assert_cost(&format!("DiT-L on {latent:?}"), cost, expected, 0.0006);
        let preset = TransitionConfig::preset("dit-l", latent, patch, ACTIONS).unwrap();
        let wide_head = wide.then_some(2048);
        let counted = TransitionConfig {
            wide_head,
            ..preset
        };
        assert_eq!(cost.parameters, counted.parameter_count());
    }
}

/// The paper's table "Architecture size and compute": parameters in millions of encoder, adapter, DiT and decoder, GFLOPs of
/// the same, and the sum of these.
const PAPER: &str = "
sd3-vae         34.3    -  910.1   49.5   270.8    -  316.5  620.2  1207.5
cosmos-ci16x16  33.5    -  910.0   48.0    47.6    -  316.5  101.7   465.9
va-vae          28.4    -  910.0   41.4   137.9    -  316.5  252.2   706.6
vjepa2.1-96    304.7 38.1  910.1  177.0   154.7 10.6  316.5  428.3   910.1
vjepa2.1       304.7    -  921.5  177.0   154.7    -  318.7  428.3   901.7
web-dino-96    303.7 38.1  910.1  177.0   155.8 10.6  316.5  428.3   911.2
web-dino       303.7    -  921.5  177.0   155.8    -  318.7  428.3   902.8
siglip2-96     427.7 46.4  910.1  177.0   211.9 12.8  316.5  428.3   969.5
siglip2        427.7    -  921.9  177.0   211.9    -  318.8  428.3   959.0
";

/// Name and figures of each row of [`PAPER`].
fn paper() -> impl Iterator<Item = (&'static str, [Option<f64>; 9])> {
    PAPER.trim().lines().map(|row| {
        let (name, figures) = row.split_once(' ').unwrap();
        let figures = figures.split_whitespace();
        let figures = figures.map(|figure| (figure != "-").then(|| figure.parse().unwrap()));
        (name, figures.collect::<Vec<_>>().try_into().unwrap())
    })
}

#[test]
fn every_row_agrees_with_the_paper() {
    for (name, expected) in paper() {
        let figures = Row::count(name).unwrap().figures();
        let found = [
            Some(figures.enc_params_m),
            figures.adapter_params_m,
            Some(figures.dit_params_m),
            Some(figures.dec_params_m),
            Some(figures.enc_gflops),
            figures.adapter_gflops,
            Some(figures.dit_gflops),
            Some(figures.dec_gflops),
            Some(figures.total_gflops),
        ];
        for (i, (found, expected)) in found.into_iter().zip(expected).enumerate() {
            // What the paper's counter adds for a ViT's norms is not in the conventions.
            let is_vit = i == 4 && figures.enc_params_m > 100.0;
            let within = if is_vit || i == 8 { 0.2 } else { 0.1 };
            let is_close = match (found, expected) {
                (Some(found), Some(expected)) => (found - expected).abs() <= within,
                (found, expected) => found == expected,
            };
            assert!(is_close, "{name}: {figures:?}");
        }
    }
}

#[test]
fn all_rows_are_named() {
    let names: Vec<&str> = paper().map(|(name, _)| name).collect();
    assert_eq!(names, Row::NAMES);
    let message = Row::count("vae").unwrap_err().to_string();
    assert!(message.contains("vjepa2.1-96"), "{message}");
}
