//! Models, data and settings of the report.

use super::{LabelledModel, markup::Markup, swatch};
use crate::findings::json::settings;

pub(super) fn header(markup: &mut Markup, title: &str, models: &[LabelledModel<'_>]) {
    markup.element("header", &[], |markup| {
        markup.leaf("p", &[("class", "eyebrow")], "World model evaluation");
        markup.leaf("h1", &[], title);
        let Some(first) = models.first() else {
            return;
        };
        if models.len() > 1 {
            table(markup, models);
        }
        let header = &first.findings.header;
        markup.element("dl", &[("class", "facts")], |markup| {
            if models.len() == 1 {
                fact(markup, "Model", |markup| markup.text(&header.model));
                fact(markup, "Weights", |markup| {
                    hash(markup, &header.hash, &header.short_hash());
                });
                fact(markup, "Latent space", |markup| markup.text(&header.space));
            }
            fact(markup, "Data", |markup| {
                markup.text(&header.data.join(", "));
                markup.text(" ");
                let short: String = header.data_digest.chars().take(8).collect();
                hash(markup, &header.data_digest, &short);
            });
            fact(markup, "Episodes", |markup| {
                markup.text(&header.episodes.to_string());
            });
            if !header.left_out.is_empty() {
                fact(markup, "Left out", |markup| {
                    markup.text(&header.left_out.join("; "));
                });
            }
            fact(markup, "Seed", |markup| {
                markup.text(&header.seed.to_string());
            });
            fact(markup, "Version", |markup| markup.text(&header.version));
        });
        markup.element("details", &[("class", "settings")], |markup| {
            markup.leaf("summary", &[], "Settings");
            markup.leaf("pre", &[], &settings(&header.settings));
            markup.leaf("p", &[], "How frames are sampled:");
            markup.leaf("pre", &[], &settings(&header.sampler));
        });
    });
}

fn fact(markup: &mut Markup, name: &str, inside: impl FnOnce(&mut Markup)) {
    markup.element("div", &[], |markup| {
        markup.leaf("dt", &[], name);
        markup.element("dd", &[], inside);
    });
}

/// The short form, with the whole one as tooltip.
fn hash(markup: &mut Markup, whole: &str, short: &str) {
    markup.leaf("code", &[("title", whole)], short);
}

fn table(markup: &mut Markup, models: &[LabelledModel<'_>]) {
    super::scrolling(markup, "Models", |markup| {
        markup.element("table", &[("class", "models")], |markup| {
            markup.leaf("caption", &[("class", "spoken")], "Models");
            markup.element("thead", &[], |markup| {
                markup.element("tr", &[], |markup| {
                    for name in ["Model", "Weights", "Latent space", "Role"] {
                        markup.leaf("th", &[("scope", "col")], name);
                    }
                });
            });
            markup.element("tbody", &[], |markup| {
                for model in models {
                    let header = &model.findings.header;
                    markup.element("tr", &[], |markup| {
                        markup.element("th", &[("scope", "row")], |markup| {
                            swatch(markup, model.number);
                            markup.text(model.label);
                            if model.label != header.model {
                                markup.leaf("p", &[("class", "says")], &header.model);
                            }
                        });
                        markup.element("td", &[], |markup| {
                            hash(markup, &header.hash, &header.short_hash());
                        });
                        markup.leaf("td", &[], &header.space);
                        let role = if model.number == 0 {
                            "baseline"
                        } else {
                            "compared with it"
                        };
                        markup.leaf("td", &[], role);
                    });
                }
            });
        });
    });
}
