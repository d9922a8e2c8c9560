use crate::judges::{Error, Result};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Placeholder {
    Instruction,
    PartialCriteria,
}

impl Placeholder {
    fn name(self) -> &'static str {
        match self {
            Self::Instruction => "instruction",
            Self::PartialCriteria => "partial_criteria",
        }
    }
}

/// A parsed text with placeholders; inserted text is not searched for placeholders.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Template(Vec<Piece>);

#[derive(Clone, Debug, PartialEq, Eq)]
enum Piece {
    Text(String),
    Slot(Placeholder),
}

impl Template {
    /// Parses the prompt with key `prompt`, which must have exactly the placeholders `expected`. Drops trailing white
    /// space, which YAML's block scalars have.
    pub(super) fn parse(
        prompt: &'static str,
        text: &str,
        expected: &[Placeholder],
    ) -> Result<Self> {
        let mut pieces = Vec::new();
        let mut plain = String::new();
        let mut rest = text.trim_end();
        while let Some((before, after)) = rest.split_once('{') {
            plain.push_str(before);
            let name = after.split_once('}').filter(|(name, _)| is_name(name));
            let Some((name, after)) = name else {
                plain.push('{');
                rest = after;
                continue;
            };
            let slot = expected.iter().find(|slot| slot.name() == name);
            let Some(slot) = slot else {
                return Err(Error::UnknownPlaceholder {
                    prompt,
                    found: name.to_owned(),
                    expected: expected.iter().map(|slot| slot.name()).collect(),
                });
            };
            pieces.push(Piece::Text(std::mem::take(&mut plain)));
            pieces.push(Piece::Slot(*slot));
            rest = after;
        }
        plain.push_str(rest);
        pieces.push(Piece::Text(plain));
        for slot in expected {
            if !pieces.contains(&Piece::Slot(*slot)) {
                return Err(Error::MissingPlaceholder {
                    prompt,
                    expected: slot.name(),
                });
            }
        }
        Ok(Self(pieces))
    }

    pub(super) fn fill(&self, instruction: &str, partial_criteria: &str) -> String {
        let pieces = self.0.iter().map(|piece| match piece {
            Piece::Text(text) => text,
            Piece::Slot(Placeholder::Instruction) => instruction,
            Piece::Slot(Placeholder::PartialCriteria) => partial_criteria,
        });
        pieces.collect()
    }
}

fn is_name(text: &str) -> bool {
    !text.is_empty() && text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
}
