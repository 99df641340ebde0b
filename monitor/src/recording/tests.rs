use super::reader::{Item, ReadError, Recording};
use std::path::Path;

use super::*;
use crate::testing::good;
use crate::tracker::Tracker;
use loopbound_shared::layout::from_content;
use loopbound_shared::sample::Origin;

const TICKS_RECORDED: u64 = 2500;

fn about() -> About {
    let started = Started { wall_ns: 1_700_000_000_000_000_000, monotonic_ns: None };
    About {
        links: 3,
        length_m: [1.0; LINKS_MAX],
        started,
        group: "g".into(),
        scenario: "[loop]\n".into(),
        run_id: "00000000000000ab".into(),
    }
}

/// 2500 ticks, each with its own q.
fn write(path: &Path) {
    let mut tracker: Tracker<3> = crate::testing::tracker();
    let _ = std::fs::remove_file(path);
    let mut writer = McapWriter::create(Stream::create(path).unwrap(), about()).unwrap();
    writer.announce(&Announce { id: 9, ..Announce::zeroed() }).unwrap();
    for tick in 0..TICKS_RECORDED {
        let mut record = good(tick);
        record.q[1] = f64::from_bits(0x3ff0_0000_0000_0001 + tick);
        let row = tracker.feed(&record).unwrap();
        writer.tick(&record, &row).unwrap();
        tracker.drain_events().for_each(|event| writer.event(&event).unwrap());
    }
    let stamp = writer.finish().unwrap();
    assert_eq!(stamp, Stamp::of(&std::fs::read(path).unwrap()));
}

fn read(path: &Path) -> (Vec<TickRecord>, usize, bool) {
    let mut recording = Recording::open(path).unwrap();
    let (mut records, mut announces) = (Vec::new(), 0);
    while let Some(item) = recording.next_item().unwrap() {
        match item {
            Item::Record(record) => records.push(*record),
            Item::Announce(announce) => announces += usize::from(announce.id == 9),
            Item::Figures(figures) => assert!(figures.v.is_nan() && figures.tick + 1 == records.len() as u64),
        }
    }
    (records, announces, recording.is_cut_off())
}

fn temporary(what: &str) -> std::path::PathBuf {
    std::env::temp_dir().join(format!("loopbound-{what}-{}.mcap", std::process::id()))
}

#[test]
fn what_was_recorded_reads_back_bit_for_bit_and_in_order() {
    let path = temporary("whole");
    write(&path);
    let (records, announces, cut_off) = read(&path);
    assert_eq!((records.len() as u64, announces, cut_off), (TICKS_RECORDED, 1, false));
    for (tick, record) in (0..).zip(&records) {
        let mut wanted = good(tick);
        wanted.q[1] = f64::from_bits(0x3ff0_0000_0000_0001 + tick);
        assert!(content_of(record) == content_of(&wanted), "tick {tick}");
    }
    std::fs::remove_file(path).unwrap();
}

#[test]
fn recordings_from_before_messages_had_an_origin_are_of_the_same_layout() {
    // As version 0.1.0 wrote them: an origin says whose run it is, and is nothing that a recording keeps of each tick.
    let layouts = [TickRecord::CONTENT_HASH, Announce::CONTENT_HASH].map(|hash| format!("{hash:016x}"));
    assert_eq!(layouts, ["963dfaf30269f74a", "4d4cd8cc61d49f3b"]);
    let record = TickRecord { origin: Origin { run_id: 5, role: 4, pid: 7 }, tick: 9, ..TickRecord::zeroed() };
    let back: TickRecord = from_content(content_of(&record)).unwrap();
    assert_eq!(back, TickRecord { origin: Origin::zeroed(), ..record });
}

#[test]
fn a_recording_cut_off_anywhere_reads_to_its_last_whole_chunk() {
    let path = temporary("cut");
    write(&path);
    let bytes = std::fs::read(&path).unwrap();
    let mut most = 0;
    for percent in [30, 55, 80] {
        std::fs::write(&path, &bytes[..bytes.len() * percent / 100]).unwrap();
        let (records, _, cut_off) = read(&path);
        assert!(cut_off && records.len() >= most, "{percent} %: {} records", records.len());
        assert!(records.iter().enumerate().all(|(at, record)| record.tick == at as u64));
        most = records.len();
    }
    assert!((1..2500).contains(&most), "{most}");
    std::fs::remove_file(path).unwrap();
}

#[test]
fn another_layout_or_build_is_refused_by_name_and_damage_is_an_error() {
    let path = temporary("other");
    write(&path);
    let bytes = std::fs::read(&path).unwrap();
    let own = format!("{:016x}", TickRecord::CONTENT_HASH);
    let at = bytes.windows(own.len()).position(|window| window == own.as_bytes()).unwrap();
    let mut other = bytes.clone();
    other[at] = if other[at] == b'0' { b'1' } else { b'0' };
    std::fs::write(&path, &other).unwrap();
    let refused = Recording::open(&path).err().unwrap().to_string();
    assert!(refused.contains("layout of TickRecord") && refused.contains(&own), "{refused}");
    let mut damaged = bytes.clone();
    // A stretch, not one byte: that may lie in a text which nothing but a person reads.
    damaged[bytes.len() / 4..bytes.len() / 2].iter_mut().for_each(|byte| *byte ^= 0xff);
    std::fs::write(&path, &damaged).unwrap();
    let read_all = || {
        let mut recording = Recording::open(&path)?;
        while recording.next_item()?.is_some() {}
        Ok(())
    };
    let read: Result<(), ReadError> = read_all();
    assert!(matches!(read, Err(ReadError::Malformed(_))), "{read:?}");
    std::fs::write(&path, b"no recording at all").unwrap();
    assert!(Recording::open(&path).is_err());
    std::fs::remove_file(path).unwrap();
}

#[test]
fn the_viewers_clock_shows_when_a_tick_was_in_real_time() {
    let mut about = about();
    about.started.monotonic_ns = Some(1_000_000);
    // Sampled 3 ms after the start of the recording, 2 ms into the run: t = 0 was 1 ms after the start.
    let mut record = good(2);
    (record.sampled_ns, record.start_plant_ns) = (4_000_000, 2_000_000);
    assert_eq!(about.started.wall_zero_ns(&record), about.started.wall_ns + 1_000_000);
    about.started.monotonic_ns = None;
    assert_eq!(about.started.wall_zero_ns(&record), about.started.wall_ns);
}

/// A block of 4 MiB of zeros, compressed as LZ4 does: one literal, a match with the byte before of all but the last five.
fn zeros_in_a_block() -> Vec<u8> {
    let matched = (4 << 20) - 6 - 4 - 15;
    let mut block = vec![0x1f, 0, 1, 0];
    block.extend(std::iter::repeat_n(255, matched / 255));
    block.extend([u8::try_from(matched % 255).unwrap(), 0x50, 0, 0, 0, 0, 0]);
    block
}

/// The beginning of a recording with a chunk that claims `claimed` bytes with checksum `crc`, and has so many blocks of
/// zeros in it.
fn with_a_chunk_of_zeros(claimed: u64, crc: u32, blocks: usize) -> Vec<u8> {
    let block = zeros_in_a_block();
    // Frame of version 1, independent blocks of 4 MiB.
    let mut frame = vec![0x04, 0x22, 0x4d, 0x18, 0x60, 0x70, 0x73];
    for _ in 0..blocks {
        frame.extend(u32::try_from(block.len()).unwrap().to_le_bytes());
        frame.extend(&block);
    }
    frame.extend([0; 4]);
    let mut chunk = [0_u64, 0, claimed].map(u64::to_le_bytes).concat();
    chunk.extend(crc.to_le_bytes());
    chunk.extend([&3_u32.to_le_bytes()[..], b"lz4", &(frame.len() as u64).to_le_bytes(), &frame].concat());
    let mut file = b"\x89MCAP0\r\n".to_vec();
    for (opcode, content) in [(0x01_u8, vec![0; 8]), (0x06, chunk)] {
        file.push(opcode);
        file.extend((content.len() as u64).to_le_bytes());
        file.extend(content);
    }
    file
}

#[test]
fn a_small_file_that_unpacks_to_gigabytes_is_refused_at_once() {
    const GIGABYTES: u64 = 4 << 30;
    let path = temporary("zeros");
    let peak_kib = || {
        let status = std::fs::read_to_string("/proc/self/status").unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
        line.trim().trim_end_matches(" kB").parse::<u64>().unwrap()
    };
    let before = peak_kib();
    // What it claims is too much; what it claims is nothing and what it has is too much; both, with and without a checksum.
    for (claimed, crc, blocks) in [
        (GIGABYTES, 1, 1),
        (GIGABYTES, 0, 1),
        (GIGABYTES, 1, 1024),
        (GIGABYTES, 0, 1024),
        (1024, 0, 1024),
        (1024, 1, 1024),
    ] {
        let file = with_a_chunk_of_zeros(claimed, crc, blocks);
        assert!(file.len() < 20 << 20, "small beside what it unpacks to");
        std::fs::write(&path, &file).unwrap();
        let refused = Recording::open(&path).map(|_| ());
        assert!(matches!(refused, Err(ReadError::Malformed(_))), "{claimed} {crc} {blocks}: {refused:?}");
    }
    std::fs::remove_file(&path).unwrap();
    let taken = peak_kib() - before;
    assert!(taken < 512 << 10, "{taken} KiB");
}
