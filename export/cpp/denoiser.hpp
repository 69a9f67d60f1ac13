// A model of nte in ONNX Runtime's C++ API: a denoiser of one sequence of frames, whose state it keeps.
#pragma once

#include <onnxruntime_cxx_api.h>

#include <cstdint>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace nte {

struct Tensor {
    std::vector<std::int64_t> shape;  // (N, C, H, W) of a channel, (N) of a scalar
    std::vector<float> values;        // in the order of the shape: a row of an image lies together
};
using Tensors = std::map<std::string, Tensor>;
using Names = std::vector<std::string>;

class Denoiser {
public:
    // Loads a model. Throws std::runtime_error if it is damaged or not one of nte, and Ort::Exception if it cannot be
    // loaded.
    explicit Denoiser(const std::filesystem::path& model, const Ort::SessionOptions& options = Ort::SessionOptions());

    // Lets the next frame start a sequence.
    void reset() { state_.clear(); }

    // Denoises the next frame; returns the wanted outputs. frame: all channels of description()["needs"], `exposure`
    // and `depth_scale`. Throws std::runtime_error for an input that is missing, and for another size without a reset;
    // the state is then that of the frame before.
    Tensors denoise(const Tensors& frame, const Names& wanted = {"image"});

    // Runs the graph alone. feed: every input, the state among them.
    Tensors run(const Tensors& feed, const Names& wanted);

    const nlohmann::json& description() const { return description_; }  // what the model's file says of itself
    const Names& outputs() const { return outputs_; }

private:
    Tensor zeros(const std::string& input, std::int64_t batch, std::int64_t height, std::int64_t width) const;

    Ort::Env env_{ORT_LOGGING_LEVEL_ERROR, "nte"};
    Ort::Session session_;
    nlohmann::json description_;
    std::map<std::string, Names> inputs_;  // input → its dimensions: numbers, or names of free ones
    Names outputs_;
    Tensors state_;  // recurrent inputs of the next frame; empty before the first one of a sequence
    std::vector<std::int64_t> size_;  // batch, height and width of the sequence
};

}  // namespace nte
