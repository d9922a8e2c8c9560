use clap::Parser;

use super::super::{Cut, DataOptions, DatasetArgs, DatasetError, Size};

#[derive(Parser)]
struct Cli {
    #[command(flatten)]
    options: DataOptions,
}

#[test]
fn file_completes_the_command_line() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("data.yaml");
    let text = "camera: [/front/image_raw, /wrist/image_raw]\ncut: instruction\ncut-seconds: 30\n\
                action-space: arm.yaml\nvalidation: 0.2\nsize: 64x96\nfit: pad\n";
    std::fs::write(&file, text).unwrap();
    let line = [
        "test",
        "--config",
        file.to_str().unwrap(),
        "--cut-seconds",
        "5",
    ];
    let options = Cli::parse_from(line).options.with_config().unwrap();
    assert_eq!(options.cameras, ["/front/image_raw", "/wrist/image_raw"]);
    assert_eq!(options.cut, [Cut::Instruction]);
    assert_eq!(options.cut_seconds, Some(5.0), "the command line wins");
    assert_eq!(options.validation, Some(0.2));
    assert_eq!(options.action_space, Some(dir.path().join("arm.yaml")));
    assert_eq!(options.fit, Some(wm_model::Fit::Pad));
    assert_eq!(
        options.size,
        Some(Size {
            height: 64,
            width: 96
        })
    );

    std::fs::write(&file, "cut-second: 30\n").unwrap();
    let error = Cli::parse_from(line).options.with_config().unwrap_err();
    assert!(error.to_string().contains("cut-second"), "{error}");
    std::fs::write(&file, "").unwrap();
    let options = Cli::parse_from(line).options.with_config().unwrap();
    assert_eq!(options.cameras, Vec::<String>::new());
}

#[test]
fn out_of_range_options_are_named() {
    for (options, named) in [
        (
            DataOptions {
                cut_seconds: Some(-1.0),
                ..DataOptions::default()
            },
            "--cut-seconds",
        ),
        (
            DataOptions {
                gap_periods: Some(f64::NAN),
                ..DataOptions::default()
            },
            "--gap-periods",
        ),
        (
            DataOptions {
                cameras: vec!["/a".into(), "/a".into()],
                ..DataOptions::default()
            },
            "--camera: /a is given twice",
        ),
    ] {
        let error = options.settings().unwrap_err().to_string();
        assert!(error.contains(named), "{error}");
    }
    let options = DataOptions {
        validation: Some(1.5),
        ..DataOptions::default()
    };
    let error = options.split_rule().unwrap_err();
    assert!(matches!(error, DatasetError::Option { .. }), "{error}");
    for bad in ["128", "0x128", "128x5000", "ax1"] {
        assert!(bad.parse::<Size>().is_err(), "{bad}");
    }
}

#[test]
fn command_takes_bags_or_a_subcommand() {
    #[derive(Debug, Parser)]
    struct Cli {
        #[command(flatten)]
        _arguments: DatasetArgs,
    }
    for good in [
        "wm bag_a bag_b -o out --size 64x64 --cut instruction",
        "wm info out",
        "wm latents out --autoencoder weights",
        "wm latents out --encoder weights --shard 0/4",
    ] {
        Cli::try_parse_from(good.split(' ')).unwrap();
    }
    for bad in [
        "wm bag",
        "wm -o out",
        "wm info",
        "wm bag -o out --size 12",
        "wm latents out --encoder weights --shard 4/4",
    ] {
        assert!(Cli::try_parse_from(bad.split(' ')).is_err(), "{bad}");
    }
}
