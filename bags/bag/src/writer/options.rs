use std::time::Duration;

use mcap::WriteOptions;

/// Compression of the chunks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compression {
    /// None.
    None,
    /// Fast.
    Lz4,
    /// Smaller.
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

    /// The name in `bag info`.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Lz4 => "lz4",
            Self::Zstd => "zstd",
        }
    }

    /// The compression that MCAP names so; none for an unknown one.
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
    /// What [`WriterOptions`] says otherwise.
    #[default]
    None,
    /// No chunks, hence no compression and no index, and no CRC of the summary: least work for the processor.
    FastWrite,
    /// Chunks in zstd's fastest level, without CRC.
    ZstdFast,
    /// Chunks of 4 MiB in zstd's slowest level.
    ZstdSmall,
}

/// How a bag is written.
#[derive(Clone, Debug)]
pub struct WriterOptions {
    /// A chunk is closed and handed to the operating system when it holds this many bytes before compression. It is
    /// also the most that a killed process loses.
    pub chunk_size: u64,
    /// A chunk is also closed once it spans this much log time; a live recorder sets it, so that a slow topic is not
    /// held back for minutes.
    pub chunk_duration: Option<Duration>,
    /// Finished chunks are also waited for to be on the disk, whenever this much time has passed since they last were:
    /// a power cut then loses at most this and the open chunk. None: when the operating system sees fit, and at the
    /// file's end.
    pub sync_interval: Option<Duration>,
    /// Compression of the chunks.
    pub compression: Compression,
    /// A preset of rosbag2; other than [`StoragePreset::None`], it goes before `compression` and `chunk_size`.
    pub preset: StoragePreset,
    /// The next file of the bag starts when this one has reached this many bytes; it may exceed them by a chunk's
    /// index, the summary and one message. None: one file.
    pub max_file_bytes: Option<u64>,
    /// The next file of the bag is begun with the first message that is later than the file's first by more than
    /// this. None: one file.
    pub max_file_duration: Option<Duration>,
    /// Whether each file after the first begins with the latched messages that hold then, so that it can be played by
    /// itself. A reader of the whole bag passes over them.
    pub repeats_latched: bool,
    /// The ROS distribution that `metadata.yaml` names; may be empty.
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

/// zstd's fastest level that the library can be told; the C++ library's is negative.
const ZSTD_FASTEST: u32 = 1;
/// zstd's slowest level that needs no special memory to read.
const ZSTD_SLOWEST: u32 = 19;

impl WriterOptions {
    /// Compression of the chunks, the preset heeded.
    pub(super) const fn chunk_compression(&self) -> Compression {
        match self.preset {
            StoragePreset::None => self.compression,
            StoragePreset::FastWrite => Compression::None,
            StoragePreset::ZstdFast | StoragePreset::ZstdSmall => Compression::Zstd,
        }
    }

    /// Bytes of a chunk before compression, the preset heeded.
    pub(super) const fn chunk_bytes(&self) -> u64 {
        match self.preset {
            StoragePreset::ZstdSmall => 4 << 20,
            _ => self.chunk_size,
        }
    }

    /// The library's options for a file of a ROS 2 bag.
    pub(super) fn mcap(&self) -> WriteOptions {
        let level = match self.preset {
            StoragePreset::ZstdSmall => ZSTD_SLOWEST,
            // Fast zstd in this thread: images are JPEG already.
            _ => ZSTD_FASTEST,
        };
        WriteOptions::new()
            .profile("ros2")
            .library(concat!("wm_bag ", env!("CARGO_PKG_VERSION")))
            .compression(self.chunk_compression().mcap())
            .compression_level(level)
            // Worker threads would outlive their use.
            .compression_threads(0)
            // Chunks are closed by the writer, so that each is flushed.
            .chunk_size(None)
            .disable_seeking(true)
            .use_chunks(self.preset != StoragePreset::FastWrite)
            .calculate_summary_section_crc(self.preset != StoragePreset::FastWrite)
            .calculate_chunk_crcs(self.preset != StoragePreset::ZstdFast)
            // mcap 0.26 builds this one from the chunks' CRCs: without them it would be wrong.
            .calculate_data_section_crc(self.preset != StoragePreset::ZstdFast)
    }
}
