//! The instructions of AMX on processors without it, so that what is built of them is tested anywhere.
//!
//! Such a processor refuses them, which the system reports by SIGILL. The handler reads the instruction, does what the
//! manual says that it does, and goes on behind it. What the manual forbids, as a product of tiles whose shapes do not fit
//! together, ends the process, as it would with AMX.

use std::cell::UnsafeCell;
use std::sync::Once;

use half::bf16;

use super::{ROW_BYTES, ROWS};

const REGISTERS: usize = 8;

/// A tile register; what is outside of its shape is zeros.
#[derive(Clone, Copy)]
struct Tile {
    rows: usize,
    row_bytes: usize,
    values: [[u8; ROW_BYTES]; ROWS],
}

impl Tile {
    const NONE: Self = Self {
        rows: 0,
        row_bytes: 0,
        values: [[0; ROW_BYTES]; ROWS],
    };

    /// The four bytes of column `column` of row `row`.
    fn four(&self, row: usize, column: usize) -> [u8; 4] {
        std::array::from_fn(|i| self.values[row][4 * column + i])
    }

    fn set(&mut self, row: usize, column: usize, four: [u8; 4]) {
        self.values[row][4 * column..][..4].copy_from_slice(&four);
    }
}

type Tiles = [Tile; REGISTERS];
type Registers = [i64; 23];
type Result<T> = std::result::Result<T, &'static str>;

thread_local! {
    /// A thread's tile registers. Without a destructor and with a constant start, a signal handler may use them.
    static TILES: UnsafeCell<Tiles> = const { UnsafeCell::new([Tile::NONE; REGISTERS]) };
}

/// Emulates the instructions in all threads from now on; true.
pub(crate) fn install() -> bool {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let handler: extern "C" fn(i32, *mut libc::siginfo_t, *mut libc::c_void) = handle;
        // SAFETY: zeros are a valid `sigaction`, and the handler has the type that SA_SIGINFO asks for.
        let result = unsafe {
            let mut action: libc::sigaction = std::mem::zeroed();
            action.sa_sigaction = handler as usize;
            action.sa_flags = libc::SA_SIGINFO;
            libc::sigaction(libc::SIGILL, &raw const action, std::ptr::null_mut())
        };
        assert_eq!(result, 0, "{}", std::io::Error::last_os_error());
    });
    true
}

/// Calls only what a signal handler may.
extern "C" fn handle(_signal: i32, _info: *mut libc::siginfo_t, context: *mut libc::c_void) {
    // SAFETY: with SA_SIGINFO the system gives a context, which it takes back when the handler returns. Nobody else uses the
    // thread's tiles: the handler does not interrupt itself.
    unsafe {
        let registers = &mut (*context.cast::<libc::ucontext_t>()).uc_mcontext.gregs;
        match TILES.with(|tiles| emulate(registers, &mut *tiles.get())) {
            Ok(length) => registers[libc::REG_RIP as usize] += length as i64,
            Err(message) => {
                libc::write(2, message.as_ptr().cast(), message.len());
                libc::write(2, c"\n".as_ptr().cast(), 1);
                // The instruction comes again, and ends the process.
                libc::signal(libc::SIGILL, libc::SIG_DFL);
            }
        }
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Prefix {
    None,
    P66,
    F3,
    F2,
}

/// What `ModRM.rm` names.
#[derive(Clone, Copy)]
enum Operand {
    Register(usize),
    /// Its address, and the bytes from one row of a tile to the next.
    Memory(*mut u8, isize),
}

/// A VEX instruction of the map 0F38 with 128 bits and W0, as all of AMX are.
struct Instruction {
    opcode: u8,
    prefix: Prefix,
    /// `ModRM.reg` and `VEX.vvvv`.
    register: usize,
    other: usize,
    operand: Operand,
    length: usize,
}

/// Does what the instruction at RIP says; its length.
///
/// # Safety
/// `registers` must be those of a thread that came to an instruction.
unsafe fn emulate(registers: &Registers, tiles: &mut Tiles) -> Result<usize> {
    // SAFETY: as for this function. What the instruction reads and writes is the program's matter, as it is with AMX.
    unsafe {
        let code = decode(registers)?;
        match (code.opcode, code.prefix, code.operand) {
            // ldtilecfg
            (0x49, Prefix::None, Operand::Memory(layout, _)) => {
                load_shapes(&layout.cast::<[u8; 64]>().read_unaligned(), tiles)?;
            }
            // tilerelease
            (0x49, Prefix::None, Operand::Register(0)) if code.register == 0 => {
                *tiles = [Tile::NONE; REGISTERS];
            }
            // tilezero
            (0x49, Prefix::F2, Operand::Register(0)) => {
                shaped(tiles, code.register)?.values = Tile::NONE.values;
            }
            // tileloadd
            (0x4b, Prefix::F2, Operand::Memory(address, pitch)) => {
                let tile = shaped(tiles, code.register)?;
                tile.values = Tile::NONE.values;
                for (row, values) in tile.values.iter_mut().enumerate().take(tile.rows) {
                    let from = address.wrapping_offset(row as isize * pitch);
                    std::ptr::copy_nonoverlapping(from, values.as_mut_ptr(), tile.row_bytes);
                }
            }
            // tilestored
            (0x4b, Prefix::F3, Operand::Memory(address, pitch)) => {
                let tile = shaped(tiles, code.register)?;
                for (row, values) in tile.values.iter().enumerate().take(tile.rows) {
                    let to = address.wrapping_offset(row as isize * pitch);
                    std::ptr::copy_nonoverlapping(values.as_ptr(), to, tile.row_bytes);
                }
            }
            // tdpbf16ps
            (0x5c, Prefix::F3, Operand::Register(inputs)) => {
                multiply(tiles, [code.register, inputs, code.other], add_bf16)?;
            }
            // tdpbssd
            (0x5e, Prefix::F2, Operand::Register(inputs)) => {
                multiply(tiles, [code.register, inputs, code.other], add_int8)?;
            }
            _ => return Err("an instruction that is not emulated"),
        }
        Ok(code.length)
    }
}

/// # Safety
/// As for [`emulate`].
unsafe fn decode(registers: &Registers) -> Result<Instruction> {
    /// By their numbers in instructions.
    const GENERAL: [i32; 16] = [
        libc::REG_RAX,
        libc::REG_RCX,
        libc::REG_RDX,
        libc::REG_RBX,
        libc::REG_RSP,
        libc::REG_RBP,
        libc::REG_RSI,
        libc::REG_RDI,
        libc::REG_R8,
        libc::REG_R9,
        libc::REG_R10,
        libc::REG_R11,
        libc::REG_R12,
        libc::REG_R13,
        libc::REG_R14,
        libc::REG_R15,
    ];
    let general = |number: usize| registers[GENERAL[number] as usize];
    let code = registers[libc::REG_RIP as usize] as *const u8;
    // SAFETY: as for this function; no byte is read that the instruction has not.
    let at = |place: usize| unsafe { *code.add(place) };
    if at(0) != 0xc4 {
        return Err("an instruction without a VEX prefix of three bytes");
    }
    let (first, second) = (at(1), at(2));
    if first & 0x1f != 2 || second & 0x84 != 0 {
        return Err("an instruction of another map, length or W");
    }
    // The highest bits of register numbers, inverted.
    let high = |bit: u8| usize::from((first >> bit) & 1 ^ 1) * 8;
    let prefix = match second & 3 {
        0 => Prefix::None,
        1 => Prefix::P66,
        2 => Prefix::F3,
        _ => Prefix::F2,
    };
    let form = at(4);
    let (mode, low) = (form >> 6, usize::from(form & 7));
    let (operand, length) = if mode == 3 {
        (Operand::Register(low + high(5)), 5)
    } else {
        let (base, index, scale, start) = if low == 4 {
            let sib = at(5);
            let index = usize::from((sib >> 3) & 7) + high(6);
            // Number 4 stands for none.
            let index = (index != 4).then_some(index);
            (usize::from(sib & 7), index, sib >> 6, 6)
        } else {
            (low, None, 0, 5)
        };
        let (displacement, length) = match mode {
            0 if base == 5 => return Err("an address without a base"),
            0 => (0, start),
            1 => (isize::from(at(start).cast_signed()), start + 1),
            _ => {
                let bytes = std::array::from_fn(|i| at(start + i));
                (i32::from_le_bytes(bytes) as isize, start + 4)
            }
        };
        let address = (general(base + high(5)) as *mut u8).wrapping_offset(displacement);
        let pitch = index.map_or(0, |index| general(index) as isize) << scale;
        (Operand::Memory(address, pitch), length)
    };
    Ok(Instruction {
        opcode: at(3),
        prefix,
        register: usize::from((form >> 3) & 7) + high(7),
        other: usize::from((second >> 3) & 15 ^ 15),
        operand,
        length,
    })
}

/// ldtilecfg: the palette, 15 bytes that are 0, and for sixteen registers, of which there are eight, the bytes of a row and
/// then the rows.
fn load_shapes(layout: &[u8; 64], tiles: &mut Tiles) -> Result<()> {
    let (head, row_bytes, rows) = (&layout[..16], &layout[16..48], &layout[48..]);
    let missing = row_bytes[2 * REGISTERS..].iter().chain(&rows[REGISTERS..]);
    if head[0] != 1 || head[1..].iter().chain(missing).any(|byte| *byte != 0) {
        return Err("ldtilecfg: another palette, or bytes that are not 0");
    }
    let shapes = row_bytes.as_chunks::<2>().0.iter().zip(rows);
    for (tile, (row_bytes, rows)) in tiles.iter_mut().zip(shapes) {
        *tile = Tile {
            rows: usize::from(*rows),
            row_bytes: u16::from_le_bytes(*row_bytes).into(),
            ..Tile::NONE
        };
        let fits = tile.rows <= ROWS && tile.row_bytes <= ROW_BYTES;
        if !fits || (tile.rows == 0) != (tile.row_bytes == 0) {
            return Err("ldtilecfg: a shape that no tile has");
        }
    }
    Ok(())
}

fn shaped(tiles: &mut Tiles, register: usize) -> Result<&mut Tile> {
    let tile = tiles.get_mut(register).ok_or("a tile register above 7")?;
    if tile.rows == 0 {
        return Err("a tile register without a shape");
    }
    Ok(tile)
}

/// A product of tiles: `add` adds to the sums (the first of `registers`) the products of inputs and weights.
fn multiply(
    tiles: &mut Tiles,
    [sums, inputs, weights]: [usize; 3],
    add: impl Fn(&mut Tile, &Tile, &Tile),
) -> Result<()> {
    if sums == inputs || inputs == weights || weights == sums {
        return Err("a product with one tile register twice");
    }
    let (inputs, weights) = (*shaped(tiles, inputs)?, *shaped(tiles, weights)?);
    let sums = shaped(tiles, sums)?;
    let fits = sums.rows == inputs.rows
        && sums.row_bytes == weights.row_bytes
        && inputs.row_bytes == 4 * weights.rows;
    if !fits || !sums.row_bytes.is_multiple_of(4) {
        return Err("a product of tiles whose shapes do not fit together");
    }
    add(sums, &inputs, &weights);
    Ok(())
}

/// 0 for numbers that f32 has with fewer bits only.
fn flush(value: f32) -> f32 {
    if value.is_subnormal() {
        return 0.0_f32.copysign(value);
    }
    value
}

/// Products of pairs of bf16. Those of the first of each pair are summed apart from those of the second; the sum of both is
/// added to what was there.
fn add_bf16(sums: &mut Tile, inputs: &Tile, weights: &Tile) {
    let pair = |four: [u8; 4]| {
        let number = |low, high| flush(bf16::from_le_bytes([low, high]).to_f32());
        [number(four[0], four[1]), number(four[2], four[3])]
    };
    for row in 0..sums.rows {
        for column in 0..sums.row_bytes / 4 {
            let mut parts = [0.0; 2];
            for k in 0..weights.rows {
                let inputs = pair(inputs.four(row, k)).into_iter();
                let factors = inputs.zip(pair(weights.four(k, column)));
                for (part, (a, b)) in parts.iter_mut().zip(factors) {
                    *part = flush(f32::mul_add(a, b, *part));
                }
            }
            let before = flush(f32::from_le_bytes(sums.four(row, column)));
            let sum = flush(before + flush(parts[0] + parts[1]));
            sums.set(row, column, sum.to_le_bytes());
        }
    }
}

/// Products of four bytes with signs.
fn add_int8(sums: &mut Tile, inputs: &Tile, weights: &Tile) {
    for row in 0..sums.rows {
        for column in 0..sums.row_bytes / 4 {
            let mut sum = i32::from_le_bytes(sums.four(row, column));
            for k in 0..weights.rows {
                let inputs = inputs.four(row, k).into_iter();
                for (a, b) in inputs.zip(weights.four(k, column)) {
                    let product = i32::from(a.cast_signed()) * i32::from(b.cast_signed());
                    sum = sum.wrapping_add(product);
                }
            }
            sums.set(row, column, sum.to_le_bytes());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tile(rows: usize, row_bytes: usize, bytes: &[u8]) -> Tile {
        let mut tile = Tile {
            rows,
            row_bytes,
            ..Tile::NONE
        };
        for (row, bytes) in tile.values.iter_mut().zip(bytes.chunks(row_bytes)) {
            row[..bytes.len()].copy_from_slice(bytes);
        }
        tile
    }

    fn of_bf16(rows: usize, values: &[f32]) -> Tile {
        let bytes: Vec<u8> = values
            .iter()
            .flat_map(|value| bf16::from_f32(*value).to_le_bytes())
            .collect();
        tile(rows, bytes.len() / rows, &bytes)
    }

    #[test]
    fn pairs_are_multiplied_as_the_manual_says() {
        // One row of two pairs, and two rows with the pairs of one column: 1 * 5 + 3 * 7 and 2 * 6 + 4 * 8.
        let (inputs, weights) = (
            of_bf16(1, &[1.0, 2.0, 3.0, 4.0]),
            of_bf16(2, &[5.0, 6.0, 7.0, 8.0]),
        );
        let mut sums = tile(1, 4, &100.0_f32.to_le_bytes());
        add_bf16(&mut sums, &inputs, &weights);
        assert_eq!(f32::from_le_bytes(sums.four(0, 0)), 170.0);
        // What is smaller than the least normal number counts as 0, before and after a product.
        for (a, b, before) in [
            (1e-39, 1e30, 0.0),
            (1e-20, 1e-20, 0.0),
            (0.0, 0.0, f32::MIN_POSITIVE / 2.0),
        ] {
            let mut sums = tile(1, 4, &f32::to_le_bytes(before));
            add_bf16(&mut sums, &of_bf16(1, &[a, 0.0]), &of_bf16(1, &[b, 0.0]));
            assert_eq!(sums.four(0, 0), [0; 4], "{a} * {b} + {before}");
        }
    }

    #[test]
    fn bytes_are_multiplied_with_their_signs() {
        let inputs = tile(1, 4, &[255, 127, 1, 128]);
        let weights = tile(1, 4, &[2, 127, 255, 128]);
        let mut sums = tile(1, 4, &10_i32.to_le_bytes());
        add_int8(&mut sums, &inputs, &weights);
        let expected = 10 - 2 + 127 * 127 - 1 + 128 * 128;
        assert_eq!(i32::from_le_bytes(sums.four(0, 0)), expected);
    }

    #[test]
    fn what_the_manual_forbids_is_refused() {
        let mut layout = [0; 64];
        (layout[0], layout[16], layout[48]) = (1, 64, 16);
        let mut tiles = [Tile::NONE; REGISTERS];
        assert_eq!(load_shapes(&layout, &mut tiles), Ok(()));
        assert!(shaped(&mut tiles, 0).is_ok() && shaped(&mut tiles, 1).is_err());
        for (at, byte) in [(0, 2), (1, 1), (16, 65), (48, 17), (48, 0), (32, 64)] {
            let mut layout = layout;
            layout[at] = byte;
            assert!(load_shapes(&layout, &mut tiles).is_err(), "{byte} at {at}");
        }
        tiles = [tile(16, 64, &[]); REGISTERS];
        let ignore = |_: &mut Tile, _: &Tile, _: &Tile| {};
        assert_eq!(multiply(&mut tiles, [0, 1, 2], ignore), Ok(()));
        assert!(multiply(&mut tiles, [0, 1, 1], ignore).is_err());
        tiles[2] = tile(15, 64, &[]);
        assert!(multiply(&mut tiles, [0, 1, 2], ignore).is_err());
    }
}
