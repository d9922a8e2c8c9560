//! The card of a model that was trained: MODEL.md in its folder.

use std::path::Path;

use anyhow::Result;
use wm_dataset::Dataset;
use wm_evaluation::{
    Settings, Shard, Subject,
    card::{self, Written},
    policy::{PolicyArgs, Setup},
    records, run,
};
use wm_metrics::findings::{CardDetails, Header, ModelFindings, Suite};
use wm_zoo::ModelFolder;

use crate::arguments::RunArgs;

/// What a card tells: what takes no search, and no second machine.
const SUITES: [Suite; 3] = [Suite::Fidelity, Suite::Control, Suite::Latents];

/// Measures what `run` trained on its episodes for validation, and writes the card. A model without a transition model
/// has none, as the encoder of a training to come; a card that somebody changed stays. Where it fails, it warns: the
/// training itself is done.
pub fn write(run: &RunArgs) {
    if let Err(error) = try_to_write(run) {
        tracing::warn!(
            "{} is trained, but has no new card: {error:#}",
            run.out.display()
        );
    }
}

fn try_to_write(run: &RunArgs) -> Result<()> {
    let name = run.out.display().to_string();
    let folder = ModelFolder::open(&name)?;
    if !folder.has_transition() {
        return Ok(());
    }
    let data = run.data(folder.encoder()?.framing())?;
    let about = about(run, &data.training, data.validation.as_ref());
    let findings = match data.validation {
        None => unmeasured(run, &folder)?,
        Some(validation) => {
            println!("measuring the model for {}", card::FILE);
            measured(run, folder, validation)?
        }
    };
    let path = run.out.join(card::FILE);
    match card::write(&path, &findings, &about)? {
        Written::Yes => println!("wrote {}", path.display()),
        Written::Kept => println!("{} was changed by hand: it stays", path.display()),
    }
    Ok(())
}

fn measured(run: &RunArgs, folder: ModelFolder, validation: Dataset) -> Result<ModelFindings> {
    let subject = Subject::new(&folder, validation, &run.cache())?;
    let records = tempfile::tempdir()?;
    let settings = Settings::brief(0);
    let on = (records.path(), Shard::WHOLE);
    let setup = Setup::new(&PolicyArgs::default())?;
    let path = run::measure(&subject, (&run.data, 0), &SUITES, &settings, &setup, on)?;
    let (heading, found) = records::merge(vec![read(&path)?])?;
    run::findings(heading, found)
}

fn read(path: &Path) -> Result<(std::path::PathBuf, records::Heading, Vec<records::Record>)> {
    let (heading, found) = records::read(path)?;
    Ok((path.to_owned(), heading, found))
}

/// Findings of nothing: there is no data that the model was not trained on.
fn unmeasured(run: &RunArgs, folder: &ModelFolder) -> Result<ModelFindings> {
    let world = folder.world_model()?;
    let mut header = Header::of(&world.name, &world.hash, &world.space.name);
    header.data = run
        .data
        .iter()
        .map(|path| path.display().to_string())
        .collect();
    header.version = env!("CARGO_PKG_VERSION").to_owned();
    Ok(ModelFindings {
        header,
        sections: Vec::new(),
    })
}

fn about(run: &RunArgs, training: &Dataset, validation: Option<&Dataset>) -> CardDetails {
    let paths = run.data.iter().map(|path| path.display().to_string());
    let count = |dataset: &Dataset| dataset.episodes().len();
    let mut data: Vec<String> = paths.collect();
    data.push(format!(
        "{} episodes to train on, {} for validation",
        count(training),
        validation.map_or(0, count)
    ));
    let recipes = std::fs::read_dir(&run.out).into_iter().flatten().flatten();
    let recipes = recipes.filter_map(|entry| entry.file_name().into_string().ok());
    let mut recipe: Vec<(String, String)> = recipes
        .filter_map(|file| Some((file.strip_suffix(".recipe.yaml")?.to_owned(), file)))
        .collect();
    recipe.sort();
    if let Some(from) = &run.from {
        recipe.push(("fine-tuned from".to_owned(), from.clone()));
    }
    CardDetails {
        name: run.model_name(),
        data,
        recipe,
        notes: validation.map_or(Vec::new(), |_| {
            vec![
                "A short evaluation by the training, on its episodes for validation: rollouts of 8 steps of at most 8 episodes, \
                 no searches. The command at the end measures more."
                    .to_owned(),
            ]
        }),
        limits: match validation {
            Some(_) => Vec::new(),
            None => vec!["It was not measured: no episodes were held out.".to_owned()],
        },
        uses_refused: Vec::new(),
        commands: vec![format!(
            "wm eval all --model {} --bags BAGS --report REPORT",
            run.out.display()
        )],
    }
}
