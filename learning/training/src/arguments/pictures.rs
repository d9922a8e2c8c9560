use clap::Args;
use wm_model::Fit;

use super::RunArgs;
use crate::recipe::{Override, Recipe, RecipeError};

/// A training of an encoder on pictures.
#[derive(Clone, Debug, Args)]
pub struct PictureRunArgs {
    /// Options of every training.
    #[command(flatten)]
    pub run: RunArgs,
    /// How pictures of another aspect fit the model, instead of the recipe's fit: crop (the middle), stretch or pad
    /// (black bars)
    #[arg(long, value_name = "FIT")]
    pub fit: Option<Fit>,
}

impl PictureRunArgs {
    /// The recipe with overridden settings, the name of the model and the fit.
    ///
    /// # Errors
    /// Names an invalid setting.
    pub fn load_recipe<R: Recipe>(&self) -> Result<R, RecipeError> {
        let name = Override::if_open("model.name", self.run.model_name());
        let fit = self.fit.map(|fit| Override::new("fit", fit.name()));
        self.run.load_recipe([name].into_iter().chain(fit))
    }
}
