//! JSON Schemas (draft 2020-12) of the documents that mvtop reads and writes, made of their types.

use schemars::generate::{Contract, SchemaSettings};
use schemars::{JsonSchema, SchemaGenerator};
use serde_json::{Map, Value};

use crate::bundle;
use crate::config::InferenceConfig;
use crate::report::Report;
use crate::request::Request;
use crate::rig;

/// Where OpenAPI has the schemas that others refer to.
const COMPONENTS: &str = "/components/schemas";

/// A document that has a schema.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Document {
    /// A prediction, as [`Report`] writes it.
    Prediction,
    /// A [`Request`].
    Request,
    /// `model.json` of a bundle.
    Bundle,
    /// A rig file.
    Rig,
    /// The settings of the inference with their defaults, an [`InferenceConfig`].
    Inference,
}

/// The schema of a document.
///
/// ```
/// use mvtop_core::schema::{self, Document};
///
/// let schema = schema::of(Document::Prediction);
/// assert_eq!(schema["properties"]["reference"]["type"], "string");
/// ```
pub fn of(document: Document) -> Value {
    let schema = match document {
        Document::Prediction => written().into_root_schema_for::<Report>(),
        Document::Request => read().into_root_schema_for::<Request>(),
        Document::Bundle => bundle::schema(read()),
        Document::Rig => rig::schema(read()),
        // Written: with every field, in order.
        Document::Inference => written().into_root_schema_for::<InferenceConfig>(),
    };
    schema.to_value()
}

/// Schemas of a prediction and a request, by name, as OpenAPI has them under `components`.
///
/// The prediction is `Report`, the request `Request`.
pub fn components() -> Map<String, Value> {
    let mut all = definitions::<Report>(Contract::Serialize);
    all.extend(definitions::<Request>(Contract::Deserialize));
    all
}

fn definitions<T: JsonSchema>(contract: Contract) -> Map<String, Value> {
    let mut settings = SchemaSettings::draft2020_12();
    settings.contract = contract;
    settings.definitions_path = COMPONENTS.into();
    let mut generator = settings.into_generator();
    generator.subschema_for::<T>();
    generator.take_definitions(true)
}

fn written() -> SchemaGenerator {
    SchemaSettings::draft2020_12()
        .for_serialize()
        .into_generator()
}

fn read() -> SchemaGenerator {
    SchemaSettings::draft2020_12().into_generator()
}
