//! Reading pickles as data.
//!
//! A pickle is a program for a small stack machine. This reads the instructions that Python's pickler writes
//! (protocols 2 to 5, `Lib/pickle.py`) into a table of values. Where Python would import something or call it, the
//! table has its name and its arguments: nothing is ever executed. A pickle that would import what attacks by pickles
//! are made with is refused all the same, by that name.
//!
//! (candle's own reader copies whatever the pickle's memo refers to, so that a dictionary that is used twice comes out
//! empty the second time and a few bytes can ask for any amount of memory, and it panics on malformed tensors; here
//! values refer to each other by number.)

mod attack;
mod reader;

use std::collections::HashMap;
use std::fmt;

use attack::is_attack;
use reader::Reader;

/// A pickle of more instructions than this describes no checkpoint, where a tensor takes about forty: it would only
/// fill the memory.
const MAX_INSTRUCTIONS: usize = 8_000_000;

/// Number of a value in the table.
pub(super) type Id = usize;

/// A value. Text is borrowed from the pickle.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value<'a> {
    None,
    Bool(bool),
    Int(i64),
    /// A number or a string of bytes, of which nothing here needs the value.
    Opaque,
    Text(&'a str),
    /// A tuple, list or set.
    Sequence(Vec<Id>),
    Dict(Vec<(Id, Id)>),
    /// Something to import.
    Global {
        module: &'a str,
        name: &'a str,
    },
    /// A call, or the making of an instance.
    Call {
        callable: Id,
        arguments: Id,
        /// What the instance is told of itself afterwards: its attributes, mostly.
        state: Option<Id>,
    },
    /// Something that lies outside the pickle, by what names it.
    Persistent(Id),
}

/// What kind of value it is, for errors: its content may be as long as the file.
impl fmt::Display for Value<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::None => "None",
            Self::Bool(_) => "a truth value",
            Self::Int(_) => "an integer",
            Self::Opaque => "a number or bytes",
            Self::Text(_) => "a text",
            Self::Sequence(_) => "a sequence",
            Self::Dict(_) => "a dictionary",
            Self::Global { .. } => "a class or function",
            Self::Call { .. } => "an object",
            Self::Persistent(_) => "a storage",
        })
    }
}

/// A pickle that was read.
#[derive(Debug)]
pub(super) struct Pickle<'a> {
    values: Vec<Value<'a>>,
    root: Id,
}

impl<'a> Pickle<'a> {
    /// Reads a pickle, or tells what is wrong with it.
    pub(super) fn parse(bytes: &'a [u8]) -> Result<Self, String> {
        let mut machine = Machine::default();
        let mut reader = Reader::new(bytes);
        for _ in 0..MAX_INSTRUCTIONS {
            let at = reader.position();
            let code = reader.byte()?;
            if code == b'.' {
                let root = machine.pop()?;
                return Ok(Self {
                    values: machine.values,
                    root,
                });
            }
            machine
                .step(code, &mut reader)
                .map_err(|reason| format!("byte {at}: {reason}"))?;
        }
        Err(format!("more than {MAX_INSTRUCTIONS} instructions"))
    }

    /// The pickled object.
    pub(super) fn root(&self) -> Id {
        self.root
    }

    /// A value of the table.
    pub(super) fn get(&self, id: Id) -> &Value<'a> {
        // Numbers come from the table itself, so there always is a value.
        self.values.get(id).unwrap_or(&Value::None)
    }
}

/// The stack machine.
#[derive(Default)]
struct Machine<'a> {
    values: Vec<Value<'a>>,
    stack: Vec<Id>,
    /// Heights of the stack at the marks that are on it.
    marks: Vec<usize>,
    memo: HashMap<u64, Id>,
}

impl<'a> Machine<'a> {
    fn push(&mut self, value: Value<'a>) {
        self.stack.push(self.values.len());
        self.values.push(value);
    }

    /// Takes the top of the stack, which must not lie under a mark.
    fn pop(&mut self) -> Result<Id, String> {
        // Without a mark, the whole stack is free.
        let floor = self.marks.last().copied().unwrap_or(0);
        if self.stack.len() <= floor {
            return Err("the stack is empty".to_owned());
        }
        self.stack
            .pop()
            .ok_or_else(|| "the stack is empty".to_owned())
    }

    fn top(&self) -> Result<Id, String> {
        self.stack
            .last()
            .copied()
            .ok_or_else(|| "the stack is empty".to_owned())
    }

    /// Takes everything above the last mark, and the mark.
    fn pop_to_mark(&mut self) -> Result<Vec<Id>, String> {
        let floor = self.marks.pop().ok_or("there is no mark")?;
        Ok(self.stack.split_off(floor.min(self.stack.len())))
    }

    /// Takes the top `count` values, in the order in which they were pushed.
    fn pop_many(&mut self, count: usize) -> Result<Vec<Id>, String> {
        let mut items = (0..count)
            .map(|_| self.pop())
            .collect::<Result<Vec<_>, _>>()?;
        items.reverse();
        Ok(items)
    }

    /// Puts the top of the stack into the memo.
    fn remember(&mut self, key: u64) -> Result<(), String> {
        let top = self.top()?;
        self.memo.insert(key, top);
        Ok(())
    }

    fn recall(&mut self, key: u64) -> Result<(), String> {
        let id = *self
            .memo
            .get(&key)
            .ok_or_else(|| format!("the memo has no entry {key}"))?;
        self.stack.push(id);
        Ok(())
    }

    /// Adds items to the sequence on top of the stack.
    fn append(&mut self, items: Vec<Id>) -> Result<(), String> {
        let top = self.top()?;
        match self.values.get_mut(top) {
            Some(Value::Sequence(sequence)) => sequence.extend(items),
            // An object that is filled like a list: what it holds is not needed.
            Some(Value::Call { .. }) => {}
            other => return Err(format!("items for {}", named(other.as_deref()))),
        }
        Ok(())
    }

    /// Adds keys and values in turn to the dictionary on top of the stack.
    fn set_items(&mut self, items: &[Id]) -> Result<(), String> {
        let (pairs, rest) = items.as_chunks::<2>();
        if !rest.is_empty() {
            return Err("a key without a value".to_owned());
        }
        let top = self.top()?;
        match self.values.get_mut(top) {
            Some(Value::Dict(dict)) => dict.extend(pairs.iter().map(|[key, value]| (*key, *value))),
            Some(Value::Call { .. }) => {}
            other => return Err(format!("items for {}", named(other.as_deref()))),
        }
        Ok(())
    }

    fn call(&mut self) -> Result<(), String> {
        let (arguments, callable) = (self.pop()?, self.pop()?);
        let is_dict = matches!(
            self.values.get(callable),
            Some(Value::Global {
                module: "collections",
                name: "OrderedDict" | "defaultdict"
            })
        );
        self.push(if is_dict {
            Value::Dict(Vec::new())
        } else {
            Value::Call {
                callable,
                arguments,
                state: None,
            }
        });
        Ok(())
    }

    fn text(&self, id: Id) -> Result<&'a str, String> {
        match self.values.get(id) {
            Some(Value::Text(text)) => Ok(text),
            other => Err(format!("expected a name, got {}", named(other))),
        }
    }

    /// Executes one instruction of the machine; numbers are those of `Lib/pickle.py`.
    fn step(&mut self, code: u8, reader: &mut Reader<'a>) -> Result<(), String> {
        match code {
            // PROTO, FRAME: nothing to know.
            0x80 => reader.skip(1)?,
            0x95 => reader.skip(8)?,
            // MARK, POP, POP_MARK, DUP.
            b'(' => self.marks.push(self.stack.len()),
            b'0' => drop(self.pop()?),
            b'1' => drop(self.pop_to_mark()?),
            b'2' => {
                let top = self.top()?;
                self.stack.push(top);
            }
            // NONE, NEWTRUE, NEWFALSE.
            b'N' => self.push(Value::None),
            0x88 => self.push(Value::Bool(true)),
            0x89 => self.push(Value::Bool(false)),
            // BININT, BININT1, BININT2, LONG1, LONG4.
            b'J' => {
                let value = i32::from_le_bytes(reader.array()?);
                self.push(Value::Int(value.into()));
            }
            b'K' => {
                let value = reader.byte()?;
                self.push(Value::Int(value.into()));
            }
            b'M' => {
                let value = u16::from_le_bytes(reader.array()?);
                self.push(Value::Int(value.into()));
            }
            0x8a => {
                let count = reader.byte()?;
                let value = long(reader.take(count.into())?);
                self.push(value);
            }
            0x8b => {
                let value = long(reader.counted::<4>()?);
                self.push(value);
            }
            // BINFLOAT.
            b'G' => {
                reader.skip(8)?;
                self.push(Value::Opaque);
            }
            // SHORT_BINUNICODE, BINUNICODE, BINUNICODE8.
            0x8c => self.push_text(reader.counted::<1>()?)?,
            b'X' => self.push_text(reader.counted::<4>()?)?,
            0x8d => self.push_text(reader.counted::<8>()?)?,
            // SHORT_BINSTRING, BINSTRING, SHORT_BINBYTES, BINBYTES, BINBYTES8, BYTEARRAY8.
            b'U' | b'C' => self.push_opaque(reader.counted::<1>()?),
            b'T' | b'B' => self.push_opaque(reader.counted::<4>()?),
            0x8e | 0x96 => self.push_opaque(reader.counted::<8>()?),
            // EMPTY_TUPLE, EMPTY_LIST, EMPTY_SET, EMPTY_DICT.
            b')' | b']' | 0x8f => self.push(Value::Sequence(Vec::new())),
            b'}' => self.push(Value::Dict(Vec::new())),
            // TUPLE1, TUPLE2, TUPLE3; TUPLE, LIST, FROZENSET; DICT.
            0x85..=0x87 => {
                let items = self.pop_many(usize::from(code - 0x84))?;
                self.push(Value::Sequence(items));
            }
            b't' | b'l' | 0x91 => {
                let items = self.pop_to_mark()?;
                self.push(Value::Sequence(items));
            }
            b'd' => {
                let items = self.pop_to_mark()?;
                self.push(Value::Dict(Vec::new()));
                self.set_items(&items)?;
            }
            // APPEND; APPENDS, ADDITEMS; SETITEM, SETITEMS.
            b'a' => {
                let item = self.pop()?;
                self.append(vec![item])?;
            }
            b'e' | 0x90 => {
                let items = self.pop_to_mark()?;
                self.append(items)?;
            }
            b's' => {
                let items = self.pop_many(2)?;
                self.set_items(&items)?;
            }
            b'u' => {
                let items = self.pop_to_mark()?;
                self.set_items(&items)?;
            }
            // GLOBAL, STACK_GLOBAL.
            b'c' => {
                let (module, name) = (reader.line()?, reader.line()?);
                self.push_global(module, name)?;
            }
            0x93 => {
                let (name, module) = (self.pop()?, self.pop()?);
                let (module, name) = (self.text(module)?, self.text(name)?);
                self.push_global(module, name)?;
            }
            // REDUCE and NEWOBJ; NEWOBJ_EX has keyword arguments, too.
            b'R' | 0x81 => self.call()?,
            0x92 => {
                self.pop()?;
                self.call()?;
            }
            // BUILD.
            b'b' => {
                let told = self.pop()?;
                let top = self.top()?;
                // A dictionary's attributes are of no interest: a state dict has versions there.
                if let Some(Value::Call { state, .. }) = self.values.get_mut(top) {
                    *state = Some(told);
                }
            }
            // BINPERSID.
            b'Q' => {
                let id = self.pop()?;
                self.push(Value::Persistent(id));
            }
            // BINPUT, LONG_BINPUT, MEMOIZE; BINGET, LONG_BINGET.
            b'q' => self.remember(reader.byte()?.into())?,
            b'r' => self.remember(u32::from_le_bytes(reader.array()?).into())?,
            0x94 => self.remember(self.memo.len() as u64)?,
            b'h' => self.recall(reader.byte()?.into())?,
            b'j' => self.recall(u32::from_le_bytes(reader.array()?).into())?,
            _ => return Err(format!("unknown instruction {code:#04x}")),
        }
        Ok(())
    }

    fn push_global(&mut self, module: &'a str, name: &'a str) -> Result<(), String> {
        if is_attack(module, name) {
            return Err(format!(
                "it imports {module}.{name}, which no checkpoint needs: if Python loaded this file, it could run any \
                 code; it is refused"
            ));
        }
        self.push(Value::Global { module, name });
        Ok(())
    }

    fn push_text(&mut self, bytes: &'a [u8]) -> Result<(), String> {
        let text = std::str::from_utf8(bytes).map_err(|e| e.to_string())?;
        self.push(Value::Text(text));
        Ok(())
    }

    fn push_opaque(&mut self, _bytes: &'a [u8]) {
        self.push(Value::Opaque);
    }
}

/// The kind of a value, if there is one.
fn named<'v>(value: Option<&'v Value<'v>>) -> &'v dyn fmt::Display {
    match value {
        Some(value) => value,
        None => &"nothing",
    }
}

/// A little-endian number in two's complement.
fn long(bytes: &[u8]) -> Value<'static> {
    if bytes.len() > size_of::<i64>() {
        return Value::Opaque;
    }
    let negative = bytes.last().is_some_and(|byte| byte & 0x80 != 0);
    let mut whole = [if negative { 0xff } else { 0 }; size_of::<i64>()];
    for (to, from) in whole.iter_mut().zip(bytes) {
        *to = *from;
    }
    Value::Int(i64::from_le_bytes(whole))
}

#[cfg(test)]
mod tests;
