use std::time::Duration;

use mcap::WriteOptions;

/// Compression of the chunks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compression {
    /// No compression.
    None,
    /// Fast compression.
    Lz4,
    /// Smaller files.
    #[default]
    Zstd,
}

impl Compression {
    const fn mcap(self) -> Option<mcap::Compression> {
        match self {
            Self::None => None,
            Self::Lz4 => Some(mcap::Compression::Lz4),
            Self::Zstd => Some(mcap::Compression::Zstd),
        }
    }

    /// Name in `bag info`.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Lz4 => "lz4",
            Self::Zstd => "zstd",
        }
    }

    /// Parses MCAP's name; `None` if unknown.
    pub(crate) fn of_mcap(name: &str) -> Option<Self> {
        match name {
            "" => Some(Self::None),
            "lz4" => Some(Self::Lz4),
            "zstd" => Some(Self::Zstd),
            _ => None,
        }
    }
}

/// The presets of rosbag2's MCAP storage (`--storage-preset-profile`, README of rosbag2_storage_mcap).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StoragePreset {
    /// The other fields of [`WriterOptions`] apply.
    #[default]
    None,
    /// No chunks, compression, index or CRC of the summary: minimal CPU load.
    FastWrite,
    /// zstd at its fastest level, without CRC.
    ZstdFast,
    /// Chunks of 4 MiB, zstd at its slowest level.
    ZstdSmall,
}

/// Options of a [`BagWriter`](crate::BagWriter).
#[derive(Clone, Debug)]
pub struct WriterOptions {
    /// Size before compression at which a chunk is closed and passed to the operating system \[bytes\]. A killed process
    /// loses at most this much.
    pub chunk_size: u64,
    /// Log time span at which a chunk is closed too. A live recorder sets it, so that messages of slow topics do not wait for
    /// minutes.
    pub chunk_duration: Option<Duration>,
    /// Interval at which finished chunks are synced to the disk: a power cut loses at most this interval and the open chunk.
    /// `None`: the operating system decides, until the file's end.
    pub sync_interval: Option<Duration>,
    /// Compression of the chunks.
    pub compression: Compression,
    /// A preset of rosbag2; except [`StoragePreset::None`], it overrides `compression` and `chunk_size`.
    pub preset: StoragePreset,
    /// Size at which the next file starts \[bytes\]; a file may exceed it by a chunk's index, the summary and one message.
    /// `None`: one file.
    pub max_file_bytes: Option<u64>,
    /// The next file starts with the first message later than the file's first by more than this. `None`: one file.
    pub max_file_duration: Option<Duration>,
    /// Whether each later file repeats the latched messages, so that it can be played by itself. A reader of the whole bag
    /// skips the repetitions.
    pub repeats_latched: bool,
    /// ROS distribution in `metadata.yaml`; may be empty.
    pub ros_distro: String,
}

impl Default for WriterOptions {
    fn default() -> Self {
        Self {
            chunk_size: WriteOptions::DEFAULT_CHUNK_SIZE,
            chunk_duration: None,
            sync_interval: None,
            compression: Compression::default(),
            preset: StoragePreset::default(),
            max_file_bytes: None,
            max_file_duration: None,
            repeats_latched: true,
            ros_distro: String::new(),
        }
    }
}

/// The library's fastest level of zstd; the C++ library has a negative one.
const ZSTD_FASTEST: u32 = 1;
/// The slowest level of zstd that readers decompress without extra memory.
const ZSTD_SLOWEST: u32 = 19;

impl WriterOptions {
    /// Compression after the preset is applied.
    pub(super) const fn chunk_compression(&self) -> Compression {
        match self.preset {
            StoragePreset::None => self.compression,
            StoragePreset::FastWrite => Compression::None,
            StoragePreset::ZstdFast | StoragePreset::ZstdSmall => Compression::Zstd,
        }
    }

    /// Chunk size after the preset is applied \[bytes before compression\].
    pub(super) const fn chunk_bytes(&self) -> u64 {
        match self.preset {
            StoragePreset::ZstdSmall => 4 << 20,
            _ => self.chunk_size,
        }
    }

    /// The options of the MCAP library.
    pub(super) fn mcap(&self) -> WriteOptions {
        let level = match self.preset {
            StoragePreset::ZstdSmall => ZSTD_SLOWEST,
            // A fast level, since images are JPEG already.
            _ => ZSTD_FASTEST,
        };
        WriteOptions::new()
            .profile("ros2")
            .library(concat!("wm_bag ", env!("CARGO_PKG_VERSION")))
            .compression(self.chunk_compression().mcap())
            .compression_level(level)
            // No worker threads: they would outlive their use.
            .compression_threads(0)
            // The writer closes chunks itself, in order to flush each.
            .chunk_size(None)
            .disable_seeking(true)
            .use_chunks(self.preset != StoragePreset::FastWrite)
            .calculate_summary_section_crc(self.preset != StoragePreset::FastWrite)
            .calculate_chunk_crcs(self.preset != StoragePreset::ZstdFast)
            // mcap 0.26 computes this CRC from those of the chunks: without them it would be wrong.
            .calculate_data_section_crc(self.preset != StoragePreset::ZstdFast)
    }
}
