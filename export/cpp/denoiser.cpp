#include "denoiser.hpp"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <functional>
#include <iterator>
#include <numeric>
#include <stdexcept>

#include "sha256.hpp"

namespace nte {
namespace {

const std::string FORMAT = "nte-onnx/2", FORWARD = "previous_forward_motion";

Tensor filled(std::vector<std::int64_t> shape, float value) {
    const auto count = std::accumulate(shape.begin(), shape.end(), std::int64_t{1}, std::multiplies<>());
    return {std::move(shape), std::vector<float>(static_cast<std::size_t>(count), value)};
}

Names dimensions(const Ort::ConstTensorTypeAndShapeInfo& info) {
    const auto sizes = info.GetShape();
    const auto symbols = info.GetSymbolicDimensions();
    Names named;
    for (std::size_t axis = 0; axis < sizes.size(); ++axis)
        named.push_back(sizes[axis] < 0 ? std::string(symbols[axis]) : std::to_string(sizes[axis]));
    return named;
}

std::string text(const std::vector<std::int64_t>& size) {
    std::string joined;
    for (const auto length : size) joined += (joined.empty() ? "" : ", ") + std::to_string(length);
    return joined;
}

// Throws for a model whose checksum does not fit: it is that of the file with 64 zeros in its place.
void require_seal(const std::filesystem::path& model, std::string bytes) {
    const std::string before = "\"sha256\": \"";
    const auto found = bytes.find(before);
    if (found == std::string::npos || bytes.size() < found + before.size() + 64) return;  // no model of nte, which is told later
    const auto at = found + before.size();
    const auto checksum = bytes.substr(at, 64);
    bytes.replace(at, 64, 64, '0');
    if (sha256(std::move(bytes)) != checksum)
        throw std::runtime_error(model.string() + ": damaged: its checksum does not fit: copy or export it again");
}

// Loads a model, if it is whole.
Ort::Session loaded(const Ort::Env& env, const std::filesystem::path& model, const Ort::SessionOptions& options) {
    std::ifstream stream(model, std::ios::binary);
    if (!stream) throw std::runtime_error(model.string() + ": cannot be read");
    const std::string bytes(std::istreambuf_iterator<char>(stream), {});
    require_seal(model, bytes);
    return Ort::Session(env, bytes.data(), bytes.size(), options);
}

}  // namespace

Denoiser::Denoiser(const std::filesystem::path& model, const Ort::SessionOptions& options)
    : session_(loaded(env_, model, options)) {
    Ort::AllocatorWithDefaultOptions allocator;
    const auto text = session_.GetModelMetadata().LookupCustomMetadataMapAllocated("nte", allocator);
    if (!text) throw std::runtime_error(model.string() + ": not a model of nte: no key 'nte' in its metadata");
    description_ = nlohmann::json::parse(text.get());
    if (description_.at("format") != FORMAT) throw std::runtime_error(model.string() + ": its format is not " + FORMAT);
    for (std::size_t i = 0; i < session_.GetInputCount(); ++i) {
        const auto type = session_.GetInputTypeInfo(i);
        const auto name = session_.GetInputNameAllocated(i, allocator);
        inputs_[name.get()] = dimensions(type.GetTensorTypeAndShapeInfo());
    }
    for (std::size_t i = 0; i < session_.GetOutputCount(); ++i)
        outputs_.emplace_back(session_.GetOutputNameAllocated(i, allocator).get());
}

Tensors Denoiser::denoise(const Tensors& frame, const Names& wanted) {
    const auto given = frame.find(description_.at("needs").at(0).get<std::string>());
    if (given == frame.end()) throw std::runtime_error("the frame lacks " + description_["needs"].dump());
    const auto batch = given->second.shape.at(0), height = given->second.shape.at(2), width = given->second.shape.at(3);
    const std::vector<std::int64_t> size{batch, height, width};
    if (!state_.empty() && size != size_)
        throw std::runtime_error("batch, height and width are " + text(size) + " after " + text(size_) +
                                 ": call reset before another size");
    Tensors feed = frame;
    feed["reset"] = filled({batch}, state_.empty() ? 1.0f : 0.0f);
    if (inputs_.count(FORWARD) && !frame.count(FORWARD))  // the graph makes it where it is NaN everywhere
        feed[FORWARD] = filled({batch, 2, height, width}, std::nanf(""));
    Names made = wanted;
    for (const auto& [name, source] : description_.at("state").items()) {
        if (!inputs_.count(name)) continue;
        feed[name] = state_.empty() ? zeros(name, batch, height, width) : state_.at(name);
        if (std::count(outputs_.begin(), outputs_.end(), source) && !std::count(made.begin(), made.end(), source))
            made.push_back(source);
    }
    Tensors results = run(feed, made);
    Tensors next;
    for (const auto& [name, source] : description_.at("state").items())
        if (inputs_.count(name)) next[name] = results.count(source) ? results.at(source) : feed.at(source);
    state_ = std::move(next);
    size_ = size;
    for (auto name = made.begin() + static_cast<std::ptrdiff_t>(wanted.size()); name != made.end(); ++name)
        results.erase(*name);
    return results;
}

Tensors Denoiser::run(const Tensors& feed, const Names& wanted) {
    const auto memory = Ort::MemoryInfo::CreateCpu(OrtDeviceAllocator, OrtMemTypeCPU);
    std::vector<const char*> inputs, outputs;
    std::vector<Ort::Value> values;
    for (const auto& [name, dimensions] : inputs_) {
        const auto found = feed.find(name);
        if (found == feed.end()) throw std::runtime_error("the input '" + name + "' is missing");
        const auto& [shape, pixels] = found->second;
        inputs.push_back(name.c_str());  // a value refers to the pixels, which ONNX Runtime only reads
        values.push_back(Ort::Value::CreateTensor<float>(
            memory, const_cast<float*>(pixels.data()), pixels.size(), shape.data(), shape.size()));
    }
    for (const auto& name : wanted) outputs.push_back(name.c_str());
    const auto made = session_.Run(
        Ort::RunOptions(), inputs.data(), values.data(), values.size(), outputs.data(), outputs.size());
    Tensors results;
    for (std::size_t i = 0; i < made.size(); ++i) {
        const auto info = made[i].GetTensorTypeAndShapeInfo();
        const auto* first = made[i].GetTensorData<float>();
        results[wanted[i]] = {info.GetShape(), std::vector<float>(first, first + info.GetElementCount())};
    }
    return results;
}

Tensor Denoiser::zeros(const std::string& input, std::int64_t batch, std::int64_t height, std::int64_t width) const {
    std::map<std::string, std::int64_t> sizes{{"batch", batch}, {"height", height}, {"width", width}};
    if (description_.contains("scales"))
        for (const auto& scale : description_.at("scales")) {
            const auto by = scale.get<std::int64_t>();
            sizes["height_" + std::to_string(by)] = (height + by - 1) / by;
            sizes["width_" + std::to_string(by)] = (width + by - 1) / by;
        }
    std::vector<std::int64_t> shape;
    for (const auto& size : inputs_.at(input)) shape.push_back(sizes.count(size) ? sizes.at(size) : std::stoll(size));
    return filled(std::move(shape), 0.0f);
}

}  // namespace nte
