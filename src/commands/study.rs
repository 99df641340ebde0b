//! `loopbound study`: many runs of one question, and what they say, as tables, pictures and sentences.
//!
//! Responsible for the command line and for the use of all cores; [`folder`] takes the results. What is run and
//! what is concluded belongs to the studies: [`paper`] and [`sweep`] in lockstep, [`load`] in real time.

pub mod boundary;
pub mod cases;
pub mod figures;
pub mod folder;
pub mod load;
pub mod measure;
pub mod paper;
pub mod sweep;
pub mod table;
pub mod verdicts;

use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use clap::{Args, Subcommand};
use loopbound_model::chain::LINKS_MAX;
use loopbound_model::law::LawKind;
use loopbound_shared::spawn;

use crate::exit::{Exit, Failure};

/// `loopbound study`.
#[derive(Debug, Args)]
pub struct StudyArgs {
    /// Which study.
    #[command(subcommand)]
    pub study: Study,
}

/// The studies.
#[derive(Debug, Subcommand)]
pub enum Study {
    /// The paper's figures and its claims: every law in every case.
    Paper(PaperArgs),
    /// How late a torque may be: the measured stability boundary against the predicted one.
    Delay(SweepArgs),
    /// How slow the loop may be: the measured stability boundary against the predicted one.
    Rate(SweepArgs),
    /// Which rate, wake-up mode and privileges this machine can keep: real groups under load, and what to choose.
    #[command(after_help = "\
Examples:
  loopbound study load --quick                         1 kHz only, under a minute
  loopbound study load                                 4 rates, 4 modes, 3 loads, with and without privileges: 7 min
  loopbound study load --rates 1kHz,5kHz --wakeups hybrid,block --privileges with --duration 10s
  loopbound study load my.toml --missed-max 0.1% --cpu-max 100%
Exit codes: 0 a setting is recommended and kept its limits when measured again; 3 otherwise; 130 interrupted, with what was measured until then.")]
    Load(load::LoadArgs),
}

/// `loopbound study paper`.
#[derive(Debug, Args)]
pub struct PaperArgs {
    /// Folder for report.md, table.csv and the pictures.
    #[arg(long, value_name = "DIR", default_value = "study-paper")]
    pub out: PathBuf,
    /// Shorter runs, fewer points.
    #[arg(long)]
    pub quick: bool,
    /// Numbers of links, such as 1,2,3; other than three get a folder each.
    #[arg(long, value_delimiter = ',', default_value = "3", value_name = "N,…")]
    pub links: Vec<usize>,
}

/// `loopbound study delay` and `loopbound study rate`.
#[derive(Debug, Args)]
pub struct SweepArgs {
    /// Folder for the report, the table and the picture; default study-delay or study-rate.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Fewer gains.
    #[arg(long)]
    pub quick: bool,
    /// Numbers of links, such as 1,2,3.
    #[arg(long, value_delimiter = ',', default_value = "3", value_name = "N,…")]
    pub links: Vec<usize>,
    /// robust, robust-ff or pd+g.
    #[arg(long, default_value = "robust", value_name = "LAW")]
    pub law: LawKind,
}

/// Runs a study.
///
/// # Errors
/// If an argument is out of its range, or the folder can't be written.
pub fn run(args: &StudyArgs) -> anyhow::Result<Exit> {
    match &args.study {
        Study::Paper(args) => {
            check_links(&args.links)?;
            paper::run(args)
        }
        Study::Delay(args) => {
            check_links(&args.links)?;
            sweep::run(args, sweep::Axis::Delay)
        }
        Study::Rate(args) => {
            check_links(&args.links)?;
            sweep::run(args, sweep::Axis::Period)
        }
        Study::Load(args) => load::run(args),
    }
}

fn check_links(links: &[usize]) -> anyhow::Result<()> {
    match links.iter().find(|n| !(1..=LINKS_MAX).contains(*n)) {
        Some(n) => Err(Failure::usage(format!("--links: found {n}, allowed: 1 to {LINKS_MAX}")).into()),
        None => Ok(()),
    }
}

/// Applies `work` to every item on all cores; results in the order of the items, whoever computed them.
pub fn on_all_cores<T: Sync, R: Send>(items: &[T], work: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(items.len().max(1));
    let next = AtomicUsize::new(0);
    let done = Mutex::new(Vec::with_capacity(items.len()));
    spawn::on_threads(threads, || {
        while let Some((at, item)) = take(&next, items) {
            let result = work(item);
            // Nobody panics with the lock held: pushing is all that is done under it.
            done.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push((at, result));
        }
    });
    let mut results = done.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    results.sort_by_key(|(at, _)| *at);
    results.into_iter().map(|(_, result)| result).collect()
}

fn take<'a, T>(next: &AtomicUsize, items: &'a [T]) -> Option<(usize, &'a T)> {
    let at = next.fetch_add(1, Ordering::Relaxed);
    items.get(at).map(|item| (at, item))
}

#[cfg(test)]
mod tests;
