//! `loopbound model`: lines of JSON with a state in, lines of JSON with the chain's terms out.
//!
//! For whoever wants to check the mathematics from another language, or use it as an oracle.

use std::io::{BufRead, BufWriter, Write};

use anyhow::Context as _;
use clap::Args;
use loopbound_model::chain::{Chain, LINKS_MAX, LinkParameters, Matrix, Vector};
use loopbound_model::quote;
use loopbound_model::with_links;
use loopbound_scenario::input::{LINE_BYTES_MAX, Line, next_line};
use loopbound_scenario::{ChainSpec, Scenario};
use loopbound_shared::say;
use serde::{Deserialize, Serialize};

use crate::commands::options::ScenarioArgs;
use crate::exit::Exit;

/// `loopbound model`.
#[derive(Debug, Args)]
pub struct ModelArgs {
    /// Where the chain comes from when a line names none.
    #[command(flatten)]
    pub scenario: ScenarioArgs,
}

/// A line in.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Question {
    /// rad, absolute angles from the downward vertical.
    q: Vec<f64>,
    /// rad/s.
    v: Option<Vec<f64>>,
    /// N·m.
    tau: Option<Vec<f64>>,
    chain: Option<ChainQuestion>,
}

/// A chain by its links, or by its coefficients.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum ChainQuestion {
    Links(LinksQuestion),
    Coefficients(CoefficientsQuestion),
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct LinksQuestion {
    mass: Vec<f64>,
    length: Vec<f64>,
    inertia: Option<Vec<f64>>,
    gravity: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct CoefficientsQuestion {
    a: Vec<Vec<f64>>,
    b: Vec<f64>,
}

/// A line out.
#[derive(Debug, Serialize)]
struct Answer {
    mass_matrix: Vec<Vec<f64>>,
    coriolis: Vec<Vec<f64>>,
    gravity: Vec<f64>,
    /// C q̇ + G, N·m.
    bias: Vec<f64>,
    acceleration: Vec<f64>,
    kinetic_energy: f64,
    potential_energy: f64,
}

#[derive(Debug, Serialize)]
struct Complaint {
    error: String,
}

/// Answers standard input on standard output.
///
/// # Errors
/// If the scenario is refused, or standard input fails.
pub fn run(args: &ModelArgs) -> anyhow::Result<Exit> {
    let scenario = args.scenario.load_system(true)?;
    answer_all(&scenario, std::io::stdin().lock(), &mut BufWriter::new(say::stdout()))
}

/// Answers each line, good or bad; one that can't be answered doesn't stop the others.
fn answer_all(scenario: &Scenario, mut input: impl BufRead, output: &mut impl Write) -> anyhow::Result<Exit> {
    let default = scenario.plant_chain();
    let mut exit = Exit::Held;
    // Bytes, not text: a line that is not UTF-8 is one bad line and not the end of the input.
    for index in 0.. {
        let Some(line) = next_line(&mut input).context("standard input")? else { break };
        let asked = match &line {
            Line::Whole(line) if line.trim_ascii().is_empty() => continue,
            Line::Whole(line) => answer(&default, line),
            Line::TooLong => Err(format!("longer than {LINE_BYTES_MAX} bytes")),
        };
        let text = match asked {
            Ok(answer) => serde_json::to_string(&answer)?,
            Err(why) => {
                exit = Exit::Usage;
                serde_json::to_string(&Complaint { error: format!("line {}: {why}", index + 1) })?
            }
        };
        // Each line at once: the asker may wait for it before it asks again.
        writeln!(output, "{text}").and_then(|()| output.flush())?;
        if say::is_in_vain() {
            break;
        }
    }
    Ok(exit)
}

fn answer(default: &ChainSpec, line: &[u8]) -> Result<Answer, String> {
    let question: Question = serde_json::from_slice(line).map_err(|e| quote::lines(&e.to_string()))?;
    let links = question.q.len();
    if !(1..=LINKS_MAX).contains(&links) {
        return Err(format!("q has {links} entries, allowed: 1 to {LINKS_MAX}"));
    }
    with_links!(links, answer_for::<N>(default, &question))
}

fn answer_for<const N: usize>(default: &ChainSpec, question: &Question) -> Result<Answer, String> {
    let chain = match &question.chain {
        None => chain_of_spec::<N>(default)?,
        Some(ChainQuestion::Links(links)) => chain_of_links(links)?,
        Some(ChainQuestion::Coefficients(c)) => chain_of_coefficients(&c.a, &c.b)?,
    };
    let zero = vec![0.0; N];
    let q = vector::<N>("q", &question.q)?;
    let v = vector::<N>("v", question.v.as_ref().unwrap_or(&zero))?;
    let tau = vector::<N>("tau", question.tau.as_ref().unwrap_or(&zero))?;
    let answer = Answer {
        mass_matrix: rows(&chain.mass_matrix(&q)),
        coriolis: rows(&chain.coriolis(&q, &v)),
        gravity: entries(&chain.gravity(&q)),
        bias: entries(&chain.bias(&q, &v)),
        acceleration: entries(&chain.acceleration(&q, &v, &tau)),
        kinetic_energy: chain.kinetic_energy(&q, &v),
        potential_energy: chain.potential_energy(&q),
    };
    answer.check_finite()?;
    Ok(answer)
}

impl Answer {
    /// JSON has no infinity: numbers too large for an answer are an error, not `null`.
    fn check_finite(&self) -> Result<(), String> {
        let matrices = self.mass_matrix.iter().chain(&self.coriolis).flatten();
        let vectors = self.gravity.iter().chain(&self.bias).chain(&self.acceleration);
        let energies = [&self.kinetic_energy, &self.potential_energy];
        if matrices.chain(vectors).chain(energies).all(|x| x.is_finite()) {
            Ok(())
        } else {
            Err("the numbers are so large that the answer is not finite".to_owned())
        }
    }
}

fn chain_of_spec<const N: usize>(spec: &ChainSpec) -> Result<Chain<N>, String> {
    match spec {
        ChainSpec::Links { mass_kg, length_m, inertia_kg_m2, gravity_m_s2 } => {
            if mass_kg.len() != N {
                let links = mass_kg.len();
                return Err(format!("q has {N} entries, but the scenario's chain has {links} links; name a chain"));
            }
            chain_of_links(&LinksQuestion {
                mass: mass_kg.clone(),
                length: length_m.clone(),
                inertia: Some(inertia_kg_m2.clone()),
                gravity: Some(*gravity_m_s2),
            })
        }
        ChainSpec::Coefficients { a, b } => chain_of_coefficients(a, b),
    }
}

fn chain_of_links<const N: usize>(links: &LinksQuestion) -> Result<Chain<N>, String> {
    let parameters = LinkParameters {
        mass_kg: array("chain.mass", &links.mass)?,
        length_m: array("chain.length", &links.length)?,
        inertia_kg_m2: links.inertia.as_ref().map(|inertia| array("chain.inertia", inertia)).transpose()?,
        gravity_m_s2: links.gravity.unwrap_or_else(|| Scenario::default().plant.gravity),
    };
    Chain::from_links(&parameters).map_err(|e| format!("chain: {e}"))
}

fn chain_of_coefficients<const N: usize>(a: &[Vec<f64>], b: &[f64]) -> Result<Chain<N>, String> {
    if a.len() != N {
        return Err(format!("chain.a has {} rows, q has {N} entries", a.len()));
    }
    let mut matrix = Matrix::<N>::zeros();
    for (i, row) in a.iter().enumerate() {
        let row: [f64; N] = array("a row of chain.a", row)?;
        for (j, value) in row.into_iter().enumerate() {
            matrix[(i, j)] = value;
        }
    }
    Chain::from_coefficients(matrix, vector("chain.b", b)?).map_err(|e| format!("chain: {e}"))
}

fn array<const N: usize>(name: &str, values: &[f64]) -> Result<[f64; N], String> {
    values.try_into().map_err(|_| format!("{name} has {} entries, q has {N}", values.len()))
}

fn vector<const N: usize>(name: &str, values: &[f64]) -> Result<Vector<N>, String> {
    Ok(Vector::from(array::<N>(name, values)?))
}

fn entries<const N: usize>(vector: &Vector<N>) -> Vec<f64> {
    vector.iter().copied().collect()
}

fn rows<const N: usize>(matrix: &Matrix<N>) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    fn ask(lines: &str) -> (Exit, Vec<Value>) {
        let mut out = Vec::new();
        let exit = answer_all(&Scenario::default(), lines.as_bytes(), &mut out).unwrap();
        let text = String::from_utf8(out).unwrap();
        (exit, text.lines().map(|line| serde_json::from_str(line).unwrap()).collect())
    }

    #[test]
    fn one_link_answers_with_its_closed_form() {
        // A uniform rod of mass m and length l on a hinge: M = m l²/3, G = m g (l/2) sin q, C = 0.
        let line = r#"{"q":[0.3],"v":[2],"tau":[1.5],"chain":{"mass":[2],"length":[0.5],"gravity":9.81}}"#;
        let (exit, answers) = ask(line);
        assert_eq!(exit, Exit::Held);
        let inertia = 2.0 * 0.25 / 3.0;
        let gravity = 2.0 * 9.81 * 0.25 * libm::sin(0.3);
        let near = |key: &str, index: Option<usize>, expected: f64| {
            let value = &answers[0][key];
            let value = index.map_or(value, |i| &value[i]).as_f64().unwrap();
            assert!((value - expected).abs() <= 1e-14 * expected.abs().max(1.0), "{key}: {value}, not {expected}");
        };
        assert!((answers[0]["mass_matrix"][0][0].as_f64().unwrap() - inertia).abs() < 1e-15);
        near("bias", Some(0), gravity);
        near("acceleration", Some(0), (1.5 - gravity) / inertia);
        near("kinetic_energy", None, 0.5 * inertia * 4.0);
        near("potential_energy", None, -2.0 * 9.81 * 0.25 * libm::cos(0.3));
    }

    #[test]
    fn a_bad_line_is_answered_in_its_place_and_the_next_one_as_if_nothing_had_been() {
        let good = r#"{"q":[0.3,-0.2,0.25],"v":[0,0,0],"tau":[0,0,0]}"#;
        for bad in [
            "nonsense",
            r#"{"q":[0.1]}"#,
            r#"{"q":[]}"#,
            r#"{"q":[0,0,0,0,0,0,0,0]}"#,
            r#"{"q":[1e999,0,0]}"#,
            r#"{"q":[1e308,0,0],"v":[1e308,0,0]}"#,
            r#"{"q":[0,0,0],"v":[0,0]}"#,
            r#"{"q":[0,0,0],"w":[0,0,0]}"#,
            r#"{"q":[0],"chain":{"mass":[-1],"length":[1]}}"#,
            r#"{"q":[0],"chain":{"mass":[1,1],"length":[1]}}"#,
            r#"{"q":[0],"chain":{"a":[[0]],"b":[1]}}"#,
            r#"{"q":[0,0],"chain":{"a":[[1,2],[3,1]],"b":[1,1]}}"#,
            &"[".repeat(LINE_BYTES_MAX),
            &" ".repeat(LINE_BYTES_MAX + 1),
        ] {
            let (exit, answers) = ask(&format!("{bad}\n\n{good}\n"));
            assert_eq!(exit, Exit::Usage, "{bad}");
            assert!(answers[0]["error"].as_str().unwrap().starts_with("line 1: "), "{bad}: {}", answers[0]);
            assert!(answers[1].get("error").is_none() && answers[1]["bias"].is_array(), "{bad}");
        }
    }

    #[test]
    fn coefficients_and_links_that_mean_the_same_chain_answer_the_same() {
        // One uniform rod again: a = m l²/3, b = m g l/2.
        let (_, answers) = ask(concat!(
            r#"{"q":[0.7],"v":[1],"chain":{"mass":[3],"length":[1],"gravity":2}}"#,
            "\n",
            r#"{"q":[0.7],"v":[1],"chain":{"a":[[1]],"b":[3]}}"#
        ));
        let acceleration = |i: usize| answers[i]["acceleration"][0].as_f64().unwrap();
        assert!((acceleration(0) - acceleration(1)).abs() < 1e-14);
    }
}
